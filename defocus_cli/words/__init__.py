"""What the commands say: lines, tables, progress, JSON documents."""
