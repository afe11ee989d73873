"""What drives a machine: recorded, planned and proposed inputs or actions."""
