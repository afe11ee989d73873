"""Where the windows of a log start: read off the outputs, carried along by the model, or fitted."""
