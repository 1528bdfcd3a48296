"""Reports in words and JSON: batches, jobs, plans, conversions, files, checks.

A record: a report as plain values, for JSON. A line: a report in words. Evidence: signs of the
format of a depth file that nobody has named.
"""
