"""Cases whose data break an assumption of the study.

Channels are late, noisy, filtered or bent, the noise is another one, memory is hidden, or something happens for a
moment only.

`case` says what a case is and `hosts` where it happens, every module of `families` is one way of breaking an
assumption with its list of cases, `path` follows the true system at any time, `generate` makes the data, and `score`
judges the answers.
"""
