"""Can the fit be trusted: convergence, inclusion, discrepancy, leave-one-out, comparison."""
