"""Counts pixels on the canvas of a mission."""

DRAWN = """
() => {
  const canvas = document.querySelector("#map-canvas canvas");
  if (!canvas?.width) return 0;
  const { width, height } = canvas;
  const copy = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, width, height);
  let count = 0;
  for (let n = 0; n < data.length; n += 4) {
    if (data[n] < 60 && data[n + 1] > 90 && data[n + 2] > 150 && data[n + 3] > 200) count += 1;
  }
  return count;
}
"""
"""Count the pixels with the full colour of GPS tracks; parts later than the chosen moment are faint."""
