"""Model criticism: convergence, inclusion, discrepancy, predictions, cross-validation, checks, calibration."""
