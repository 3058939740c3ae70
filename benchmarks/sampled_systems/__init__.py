"""Systems that one sensor of a position shows: decays, an axis, a beam, an oscillator under noise of several kinds."""
