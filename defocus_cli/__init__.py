"""Command line of defocus."""
