"""A synthetic park that can be photographed: the sample, and the ground truth of many tests.

The world is metres: east, north, up, with (0, 0, 0) on the ground at the south-west corner of the park.
Colours are RGB, 0-255. Everything comes from a random generator that the caller passes in, so the same
seed gives the same park and the same photos. `world` builds the park, `stage` sets its light, `render` takes
a photo of it, `overhead` looks straight down on it.

It is test data only: methods are evaluated on real photos.
"""
