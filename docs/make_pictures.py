"""Make the pictures of the documentation: `python docs/make_pictures.py`.

Makes the sample in a temporary folder, localizes one of its queries, and draws what `expmap localize` would.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from webapp.core.tags.detect import modules
from webapp.progress import Progress
from webapp.render.answer_pictures import map_picture, match_picture
from webapp.sample import make
from webapp.settings import Settings
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions

QUERY = "queries/query_02.jpg"
WIDTH_PX = 1000
PICTURES = Path(__file__).resolve().parent / "pictures"


def main() -> None:
    """Write all pictures."""
    settings = Settings()
    tags().quantize(16).save(PICTURES / "tags.png", optimize=True)
    with tempfile.TemporaryDirectory() as folder:
        cfg = make.make_sample(Path(folder) / "sample", settings=settings, progress=Progress()).cfg_path
        localizer = open_pipeline(cfg, OpenOptions(), settings=settings, progress=Progress())
        query = cfg.parent / QUERY
        answer = localizer.localize(query, top=5)
        limits = settings.photo
        save(map_picture(cfg, localizer.map, answer=answer, limits=limits), "where.jpg")
        matches = match_picture(cfg, localizer.map, query=query, answer=answer, limits=limits)
        if matches is None:
            raise SystemExit(f"{QUERY} has no matches to draw")
        save(matches, "matches.jpg")
        save(contact_sheet(sorted((cfg.parent / "photos").glob("*.jpg"))[::8]), "photos.jpg")


def tags() -> Image.Image:
    """Draw printed tags in a row, with what is written under them."""
    picture = Image.new("RGB", (1000, 440), "white")
    pen = ImageDraw.Draw(picture)
    for place, (family, number) in enumerate((("36h11", 3), ("36h11", 4), ("4x4_50", 7))):
        pattern = modules(family, number)
        black = Image.fromarray(np.where(pattern, 0, 255).astype(np.uint8)).resize(
            (240, 240), Image.Resampling.NEAREST
        )
        left = 50 + 330 * place
        picture.paste(black.convert("RGB"), (left, 50))
        name = f"{family}  {number}  ·  150 mm"
        pen.text((left + 120, 330), name, fill="black", anchor="mm", font_size=20)
    pen.line([(50, 410), (210, 410)], fill="black", width=2)
    for tick in range(11):
        pen.line(
            [(50 + 16 * tick, 410), (50 + 16 * tick, 410 - (12 if tick % 5 == 0 else 6))],
            fill="black",
            width=2,
        )
    pen.text((222, 410), "100 mm", fill="black", anchor="lm", font_size=18)
    return picture


def contact_sheet(paths: list[Path]) -> Image.Image:
    """Put photos of one size next to each other, four in a row."""
    photos = [np.asarray(Image.open(path).resize((320, 240))) for path in paths]
    rows = [np.hstack(photos[i : i + 4]) for i in range(0, len(photos) - 3, 4)]
    return Image.fromarray(np.vstack(rows))


def save(picture: Image.Image, name: str) -> None:
    """Write a picture, small enough for a page."""
    height = round(picture.height * WIDTH_PX / picture.width)
    PICTURES.mkdir(exist_ok=True)
    small = picture.convert("RGB").resize((WIDTH_PX, height), Image.Resampling.LANCZOS)
    small.save(PICTURES / name, quality=82, optimize=True)


if __name__ == "__main__":
    main()
