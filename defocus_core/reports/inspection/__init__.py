"""The contents of a file for `defocus info`: figures, evidence, repair; the frames of a shot.

A record: a report as plain values, for JSON. A line: a report in words. Evidence: signs of the
format of a depth file whose format was not given.
"""
