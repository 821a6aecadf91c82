"""Pages and API of landmarks, control points, and placing photos by them."""
