"""Counts pixels on the canvas of a mission."""

_COUNT = """
  const canvas = document.querySelector("#map-canvas canvas");
  if (!canvas?.width) return 0;
  const { width, height } = canvas;
  const copy = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, width, height);
  let count = 0;
  for (let n = 0; n < data.length; n += 4) {
    if (fits(data[n], data[n + 1], data[n + 2]) && data[n + 3] > 200) count += 1;
  }
  return count;
}
"""
DRAWN = "() => { const fits = (r, g, b) => r < 60 && g > 90 && b > 150;" + _COUNT
"""Count the pixels with the full colour of GPS tracks; parts later than the chosen moment are faint."""
OF_COLOUR = (
    "(colour) => { const wanted = parseInt(colour.slice(1), 16);"
    " const fits = (r, g, b) => (r << 16) + (g << 8) + b === wanted;" + _COUNT
)
"""Count the pixels of a colour, `#rrggbb`."""
