"""NUTS on the collapsed model, exact conditional draws, and the fitted result with its netCDF file."""
