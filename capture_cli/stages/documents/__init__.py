"""The documents and arrays of results, from the values that were found."""
