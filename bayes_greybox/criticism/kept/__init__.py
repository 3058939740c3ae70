"""Results of model criticism in the saved file of a fit."""
