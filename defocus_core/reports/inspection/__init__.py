"""What is in a file, as `defocus info` tells it: figures, evidence, repair; and a shot's frames.

A record: a report as plain values, for JSON. A line: a report in words. Evidence: signs of the
format of a depth file that nobody has named.
"""
