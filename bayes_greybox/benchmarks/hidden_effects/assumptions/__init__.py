"""Cases whose data break an assumption of the study: late, noisy or filtered channels, other noise, hidden memory.

`case` says what a case is and `hosts` where it happens, every module of `families` is one way of breaking an
assumption with its list of cases, `path` follows the true system at any time, `generate` makes the data, and `score`
judges what was said of them.
"""
