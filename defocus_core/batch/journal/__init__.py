"""What a batch has done: records in a journal, locks, reasons to do jobs again, and progress."""
