"""Options that commands share, and the types of their values.

A bundle: options that a command receives as one object, such as `WorkerConfig`, the processes that
compute.
A heading: the name of a section of ``--help``.
"""
