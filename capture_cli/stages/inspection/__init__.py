"""What `inspect` says of one file, of a result folder, and of a run that was interrupted."""
