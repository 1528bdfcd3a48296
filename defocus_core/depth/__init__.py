"""Repair of depth maps: noise, anti-aliased and soft edges, quantised levels."""
