"""What every room stands on and no machine is known in: documents, plug-in folders, signals, progress, numbers."""
