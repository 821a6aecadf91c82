"""A map on paper: PNG or PDF with title, legend, scale, north and attribution."""
