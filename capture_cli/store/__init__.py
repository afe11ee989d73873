"""What passes between commands: Zarr stores and result folders, each with a schema and a version.

In: arrays and JSON documents. Out: a store or folder that appears whole or not at all (`output`), with its provenance;
or the same arrays and documents, read and checked. One kind of file = one module, whose table of arrays makes the
writer, the check and docs/schemas.md. What an estimate or a log means is not known here.
"""
