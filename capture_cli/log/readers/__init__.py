"""Files that logs come in, as columns of numbers: CSV and Parquet."""
