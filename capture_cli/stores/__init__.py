"""What passes between stages: Zarr stores and result directories, each with a schema and a version."""
