"""HTML pages, each of one file: reports of comparisons, and the page to choose a focus on."""
