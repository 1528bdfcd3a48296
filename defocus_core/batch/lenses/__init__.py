"""Lens files that ship, one look each, and their names."""
