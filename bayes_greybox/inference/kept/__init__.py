"""The stored form of a fit: groups of draws, the objects of ArviZ, the netCDF file."""
