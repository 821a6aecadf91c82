"""Large images, read in strips, and their tiles."""

import io
import warnings

import numpy as np
import pytest
import rasterio
from PIL import Image

from tests.photo_files import progressive_jpeg
from webapp.errors import Cancelled, MissingPart, PhotoError
from webapp.files.satellite.pyramid import max_zoom, write_pyramid
from webapp.files.satellite.raster import opened_raster, reduced
from webapp.progress import Progress
from webapp.settings import SatelliteLimits

LIMITS = SatelliteLimits()


def gradient(width, height):
    y, x = np.mgrid[0:height, 0:width]
    across, down = x * 255 // max(width - 1, 1), y * 255 // max(height - 1, 1)
    return np.stack([across, down, (across + down) // 2], axis=2).astype(np.uint8)


@pytest.fixture(params=["rasterio", "Pillow"])
def reader(request, absent):
    """With rasterio, and without it."""
    if request.param == "Pillow":
        absent("geotiff")
    return request.param


@pytest.fixture
def read(tmp_path, reader):
    """Read all pixels of an image given as Pillow image or bytes."""

    def all_pixels(image, kind="PNG", rows=64, limits=LIMITS):
        path = tmp_path / "image"
        if isinstance(image, bytes):
            path.write_bytes(image)
        else:
            image.save(path, format=kind)
        with opened_raster(path, limits=limits) as raster:
            return np.concatenate(list(raster.strips(rows)))

    return all_pixels


def write_tiff(path, bands, **options):
    count, height, width = bands.shape
    with rasterio.open(
        path, "w", driver="GTiff", count=count, height=height, width=width, dtype=bands.dtype, **options
    ) as out:
        out.write(bands)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
class TestColours:
    def test_colours_as_they_are(self, read):
        pixels = gradient(300, 200)
        assert (read(Image.fromarray(pixels)) == pixels).all()

    def test_grey_becomes_colours(self, read):
        pixels = gradient(90, 70)[:, :, 0]
        assert (read(Image.fromarray(pixels)) == pixels[:, :, None]).all()

    def test_transparency_becomes_white(self, read):
        rgba = np.zeros((4, 6, 4), np.uint8)
        rgba[:, 3:] = (10, 20, 30, 255)
        pixels = read(Image.fromarray(rgba))
        assert (pixels[:, :3] == 255).all()
        assert (pixels[:, 3:] == (10, 20, 30)).all()

    def test_half_transparent_is_half_white(self, read):
        rgba = np.full((4, 6, 4), (0, 100, 200, 128), np.uint8)
        assert (np.abs(read(Image.fromarray(rgba)).astype(int) - (127, 177, 227)) <= 1).all()

    def test_a_palette_is_looked_up(self, read):
        image = Image.fromarray((gradient(40, 30) // 128) * 255).quantize(8)
        assert (read(image) == np.asarray(image.convert("RGB"))).all()

    def test_sixteen_bits_keep_the_upper_eight(self, read):
        values = np.linspace(0, 65535, 256 * 4).astype(np.uint16).reshape(4, 256)
        assert np.abs(read(Image.fromarray(values))[:, :, 0].astype(int) - (values / 257)).max() <= 1

    def test_floats_are_stretched_and_no_data_is_white(self, tmp_path):
        values = np.linspace(100, 300, 100 * 100, dtype=np.float32).reshape(1, 100, 100)
        values[0, :, 0] = -9999
        write_tiff(tmp_path / "dem.tif", values, nodata=-9999)
        with opened_raster(tmp_path / "dem.tif", limits=LIMITS) as raster:
            (pixels,) = raster.strips()
        assert (pixels[:, 0] == 255).all()
        assert pixels[1, 50, 0] < 10
        assert pixels[98, 50, 0] > 245

    @pytest.mark.parametrize("dtype", ["float32", "float64"])
    @pytest.mark.parametrize("share", [0.3, 1.0])
    @pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 3e38, -3e38])
    def test_floats_without_bounds_become_colours(self, tmp_path, dtype, share, value):
        bands = np.linspace(0.0, 1.0, 600).reshape(1, 20, 30).astype(dtype)
        bands.flat[: int(600 * share)] = value
        path = tmp_path / "odd.tif"
        write_tiff(path, bands)
        with opened_raster(path, limits=LIMITS) as raster, warnings.catch_warnings():
            warnings.simplefilter("error")
            assert np.concatenate(list(raster.strips())).shape == (20, 30, 3)

    def test_the_fourth_band_of_a_survey_is_not_opacity(self, tmp_path):
        bands = np.stack([np.full((20, 20), v, np.uint8) for v in (10, 20, 30, 0)])
        write_tiff(tmp_path / "nir.tif", bands, photometric="RGB", alpha="NO")
        with opened_raster(tmp_path / "nir.tif", limits=LIMITS) as raster:
            assert (next(raster.strips()) == (10, 20, 30)).all()


class TestRefused:
    def test_other_formats(self, read):
        for kind in ("GIF", "BMP", "WEBP"):
            with pytest.raises(PhotoError, match="not a PNG, JPEG or TIFF"):
                read(Image.fromarray(gradient(20, 20)), kind)

    def test_empty(self, read):
        with pytest.raises(PhotoError, match="empty"):
            read(b"")

    @pytest.mark.parametrize("kind", ["PNG", "JPEG", "TIFF"])
    @pytest.mark.parametrize("kept", [0.02, 0.5, 0.98])
    @pytest.mark.parametrize("rows", [64, 1000])
    def test_cut_off(self, read, reader, kind, kept, rows):
        error = MissingPart if (reader, kind) == ("Pillow", "TIFF") else PhotoError
        buffer = io.BytesIO()
        noise = np.random.default_rng(1).integers(0, 256, (300, 400, 3), dtype=np.uint8)
        Image.fromarray(noise).save(buffer, format=kind)
        with pytest.raises(error, match=r"cut off|damaged|rasterio is not installed"):
            read(buffer.getvalue()[: int(len(buffer.getvalue()) * kept)], rows=rows)

    def test_a_jpeg_of_very_many_scans(self, read):
        with pytest.raises(PhotoError, match="compressed in an unusual way"):
            read(progressive_jpeg(33))

    def test_a_line(self, read):
        with pytest.raises(PhotoError, match="200000 pixels long"):
            read(Image.new("L", (200_000, 1)))

    def test_larger_than_the_limits(self, read):
        image = Image.fromarray(gradient(1100, 1000))
        with pytest.raises(PhotoError, match="1 megapixels, more than the limit of 1"):
            read(image, limits=SatelliteLimits(max_megapixels=1.0))
        with pytest.raises(PhotoError, match="MB, more than the limit"):
            read(image, limits=SatelliteLimits(max_mb=0.001))


def test_a_tiff_needs_rasterio(tmp_path, absent):
    Image.fromarray(gradient(20, 20)).save(tmp_path / "image.tif")
    absent("geotiff")
    with (
        pytest.raises(MissingPart, match=r"experience-map\[geotiff\]"),
        opened_raster(tmp_path / "image.tif", limits=LIMITS),
    ):
        pass


@pytest.mark.parametrize("size", [(1000, 700), (701, 1003), (100, 3), (999, 1)])
def test_a_reduced_copy_has_the_mean_colours(tmp_path, reader, size):
    pixels = gradient(*size)
    Image.fromarray(pixels).save(tmp_path / "image.png")
    with opened_raster(tmp_path / "image.png", limits=LIMITS) as raster:
        small = reduced(raster, 100)
    assert max(small.shape[:2]) <= 100
    assert np.abs(small.mean(axis=(0, 1)) - pixels.mean(axis=(0, 1))).max() < 3


class TestPyramid:
    @pytest.fixture
    def tiles(self, tmp_path):
        """Return a function from (zoom, x, y) to the RGBA pixels of a tile, and the image's pixels."""

        def make(width, height):
            pixels = gradient(width, height)
            Image.fromarray(pixels).save(tmp_path / "image.png")
            with opened_raster(tmp_path / "image.png", limits=LIMITS) as raster:
                write_pyramid(raster, tmp_path / "tiles", progress=Progress())

            def tile(z, x, y):
                (path,) = (tmp_path / "tiles" / f"{z}").glob(f"{x}_{y}.*")
                return np.asarray(Image.open(path).convert("RGBA")).astype(int)

            return tile, pixels

        return make

    def test_largest_zoom_shows_the_image_itself(self, tiles):
        tile, pixels = tiles(700, 530)
        assert max_zoom(width=700, height=530) == 2
        assert np.abs(tile(2, 1, 1)[:, :, :3] - pixels[256:512, 256:512])[:, :, :2].max() < 12
        edge = tile(2, 2, 2)
        assert (edge[: 530 - 512, : 700 - 512, 3] == 255).all()
        assert (edge[530 - 512 :, :, 3] == 0).all()
        assert (edge[:, 700 - 512 :, 3] == 0).all()

    def test_zoom_0_shows_everything_in_one_tile(self, tiles, tmp_path):
        tile, pixels = tiles(701, 531)
        (only,) = (tmp_path / "tiles" / "0").iterdir()
        assert only.name == "0_0.webp"
        whole = tile(0, 0, 0)
        # 2^2 pixels of the image make one of the tile; the last ones are partial
        assert whole[:, :, 3].sum() == 255 * 176 * 133
        assert np.abs(whole[:132, :175, :3] - pixels[2:530:4, 2:702:4][:132, :175])[:, :, :2].max() < 12

    def test_every_place_has_a_tile(self, tiles, tmp_path):
        tiles(1025, 3)
        count = {z.name: len(list(z.iterdir())) for z in (tmp_path / "tiles").iterdir()}
        assert count == {"3": 5, "2": 3, "1": 2, "0": 1}

    def test_a_small_image_is_one_tile(self, tiles, tmp_path):
        tile, _ = tiles(256, 256)
        assert [p.name for p in (tmp_path / "tiles").iterdir()] == ["0"]
        assert tile(0, 0, 0).shape == (256, 256, 4)

    def test_stopped_work_leaves_nothing_that_looks_complete(self, tmp_path):
        class Stop(Progress):
            done = 0

            def advance(self, steps=1):
                self.done += steps

            def cancelled(self):
                return self.done >= 1

        Image.fromarray(gradient(600, 600)).save(tmp_path / "image.png")
        with opened_raster(tmp_path / "image.png", limits=LIMITS) as raster, pytest.raises(Cancelled):
            write_pyramid(raster, tmp_path / "tiles", progress=Stop())
        assert not (tmp_path / "tiles").exists()
        with opened_raster(tmp_path / "image.png", limits=LIMITS) as raster:
            write_pyramid(raster, tmp_path / "tiles", progress=Progress())
        assert (tmp_path / "tiles" / "2" / "2_2.webp").exists()


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("kind", ["PNG", "GTiff"])
@pytest.mark.parametrize("bits", [1, 2, 4])
def test_grey_of_few_bits_goes_from_black_to_white(tmp_path, kind, bits):
    levels = np.tile(np.arange(2**bits, dtype=np.uint8).repeat(8), (16, 1))
    path = tmp_path / "plan"
    with rasterio.open(
        path, "w", driver=kind, count=1, height=16, width=levels.shape[1], dtype="uint8", nbits=bits
    ) as out:
        out.write(levels, 1)
    with opened_raster(path, limits=LIMITS) as raster:
        read = next(raster.strips())
    expected = levels.astype(int) * 255 // (2**bits - 1)
    assert np.abs(read.astype(int) - expected[:, :, None]).max() <= 1


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("bits", [1, 4, 8])
def test_grey_that_counts_from_white_stays_right(tmp_path, bits):
    path = tmp_path / "plan.tif"
    write_tiff(
        path, np.array([[[0] * 8 + [2**bits - 1] * 8] * 16], np.uint8), nbits=bits, photometric="MINISWHITE"
    )
    with opened_raster(path, limits=LIMITS) as raster:
        read = next(raster.strips())
    assert read[0, 0].tolist() == [255] * 3 and read[0, -1].tolist() == [0] * 3
