"""The record of jobs that were done: journal, lock, identity, progress."""
