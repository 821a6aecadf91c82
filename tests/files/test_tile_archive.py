"""Files of map tiles: what is in them is read, and what is none of them is refused."""

import sqlite3
from contextlib import closing

import pmtiles.tile
import pytest
from pmtiles.writer import Writer

from webapp.errors import InputError, StorageError
from webapp.files.satellite.tile_archive import opened_tiles

PNG = b"\x89PNG\r\n\x1a\n picture"


def write_mbtiles(
    path, tiles, schema="CREATE TABLE tiles (zoom_level, tile_column, tile_row, tile_data BLOB)"
):
    with closing(sqlite3.connect(path)) as database:
        database.execute(schema)
        database.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", tiles)
        database.commit()


def write_pmtiles(path, tiles):
    kinds = pmtiles.tile.TileType, pmtiles.tile.Compression
    with path.open("wb") as file:
        writer = Writer(file)
        for zoom, x, y, data in tiles:
            writer.write_tile(pmtiles.tile.zxy_to_tileid(zoom, x, y), data)
        bounds = dict.fromkeys(
            [f"{end}_{axis}_e7" for end in ("min", "max", "center") for axis in ("lon", "lat")], 0
        )
        header = {"tile_type": kinds[0].PNG, "tile_compression": kinds[1].NONE, "center_zoom": 0, **bounds}
        writer.finalize(header, {})


def test_rows_count_from_the_north(tmp_path):
    write_mbtiles(tmp_path / "a", [(2, 1, 3, PNG)])  # MBTiles count from the south
    write_pmtiles(tmp_path / "b", [(2, 1, 0, PNG)])
    for name in ("a", "b"):
        with opened_tiles(tmp_path / name) as archive:
            assert archive.tile(2, 1, 0) == PNG
            assert archive.tile(2, 1, 3) is archive.tile(1, 0, 0) is None


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "neither MBTiles nor PMTiles"),
        (b"PMTiles\x02 old", "neither MBTiles nor PMTiles"),
        (b"PMTiles\x03", "damaged"),
        (b"PMTiles\x03" + b"\xff" * 300, "damaged"),
        (b"SQLite format 3\0" + b"\xff" * 300, "damaged"),
    ],
)
def test_what_is_no_file_of_tiles_is_refused(tmp_path, content, message):
    (tmp_path / "x").write_bytes(content)
    with pytest.raises(InputError, match=message), opened_tiles(tmp_path / "x") as archive:
        archive.tile(2, 1, 0)


def test_vector_tiles_and_other_databases_are_refused(tmp_path):
    write_mbtiles(tmp_path / "vector", [(0, 0, 0, b"\x1f\x8b\x08 gzip")])
    with (
        pytest.raises(InputError, match="no PNG, JPEG or WebP"),
        opened_tiles(tmp_path / "vector") as archive,
    ):
        archive.tile(0, 0, 0)
    with closing(sqlite3.connect(tmp_path / "other")) as database:
        database.execute("CREATE TABLE a (b)")
        database.commit()
    with pytest.raises(InputError, match="no such table"), opened_tiles(tmp_path / "other") as archive:
        archive.tile(0, 0, 0)
    with pytest.raises(StorageError), opened_tiles(tmp_path / "missing"):
        pass
