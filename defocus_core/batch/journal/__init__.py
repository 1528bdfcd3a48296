"""What a batch has done: records in a journal, its lock, identity of jobs, and progress."""
