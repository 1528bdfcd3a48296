"""Options that commands share, the types of their values, and bundles passed as one object."""
