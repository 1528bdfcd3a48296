"""Content that a nearer surface hides: where the lens sees it, and what is put there."""
