"""A picture through the pipeline: preparation, regions, layer order, hidden fill and drafts."""
