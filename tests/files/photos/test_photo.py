"""Photos are decoded upright, completely and within limits, or rejected."""

import contextlib
import io
import struct
import tracemalloc
import zlib

import cv2
import numpy as np
import piexif
import pillow_heif
import pytest
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile

from tests.photo_files import progressive_jpeg
from webapp.errors import PhotoError
from webapp.files.decode import contrast_note, decode, has_too_many_scans, open_image
from webapp.files.photos.exif import Gps
from webapp.files.photos.photo import read_facts, read_gray, read_upright, turn_upright
from webapp.settings import PhotoLimits

LIMITS = PhotoLimits()


def picture(width=48, height=36):
    """Make a smooth picture without any symmetry: (h, w, 3), red, green, blue."""
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([x * 255 // width, y * 255 // height, (x + 2 * y) % 256], -1).astype(np.uint8)


def encode(pixels, kind, *, mode=None, **options):
    file = io.BytesIO()
    image = Image.fromarray(pixels)
    (image.convert(mode) if mode else image).save(file, kind, **options)
    return file.getvalue()


def stored(upright, orientation):
    """Return an upright picture as stored by a camera with an orientation."""
    methods = {
        2: Image.Transpose.FLIP_LEFT_RIGHT, 3: Image.Transpose.ROTATE_180, 4: Image.Transpose.FLIP_TOP_BOTTOM,
        5: Image.Transpose.TRANSPOSE, 6: Image.Transpose.ROTATE_90, 7: Image.Transpose.TRANSVERSE,
        8: Image.Transpose.ROTATE_270,
    }  # fmt: skip
    image = Image.fromarray(upright)
    return np.asarray(image.transpose(methods[orientation]) if orientation in methods else image)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_all_eight_orientations_are_upright(orientation):
    upright = picture()
    turned = turn_upright(stored(upright, orientation), orientation)
    assert np.array_equal(turned, upright)
    assert turned.flags.c_contiguous


@pytest.mark.parametrize("kind", ["PNG", "WEBP", "TIFF", "JPEG"])
@pytest.mark.parametrize("orientation", [*range(10), 65535])
def test_files_of_every_orientation_are_upright(kind, orientation):
    exif = Image.Exif()
    exif[274] = orientation
    lossless = {"lossless": True} if kind == "WEBP" else {"quality": 95} if kind == "JPEG" else {}
    data = encode(stored(picture(), orientation), kind, exif=exif, **lossless)
    colour, gray = read_upright(data, limits=LIMITS), read_gray(data, limits=LIMITS)
    facts = read_facts(data, limits=LIMITS)
    assert (facts.width, facts.height) == gray.full_size == (48, 36)
    off = np.abs(colour[:, :, ::-1].astype(int) - picture())
    assert off.mean() < (6 if kind == "JPEG" else 1e-9)
    assert gray.pixels.shape == (36, 48)


def test_shared_photos_of_every_orientation_are_alike(shared_data):
    for shape in ("landscape", "portrait"):
        first = read_upright(shared_data / "odd_photos" / f"{shape}_1.jpg", limits=LIMITS, max_side=100)
        for orientation in range(2, 9):
            path = shared_data / "odd_photos" / f"{shape}_{orientation}.jpg"
            other = read_upright(path, limits=LIMITS, max_side=100)
            assert read_facts(path, limits=LIMITS).orientation == orientation
            assert other.shape == first.shape
            # by correlation: brightness differs, and numbers are drawn on; turned wrongly it is below 0.7
            assert np.corrcoef(other.ravel(), first.ravel())[0, 1] > 0.96


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
@pytest.mark.parametrize("subsampling", ["4:4:4", "4:2:0"])
def test_grey_jpegs_are_those_of_opencv(tmp_path, orientation, subsampling):
    noisy = (picture(170, 130).astype(int) + np.random.default_rng(0).integers(-40, 40, (130, 170, 3))).clip(
        0, 255
    )
    exif = piexif.dump({"0th": {274: orientation}})
    path = tmp_path / "photo.jpg"
    path.write_bytes(encode(noisy.astype(np.uint8), "JPEG", exif=exif, subsampling=subsampling))
    assert np.array_equal(read_gray(path, limits=LIMITS).pixels, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))


def test_grey_shared_jpegs_are_those_of_opencv(shared_data):
    paths = sorted((shared_data / "getty" / "photos").glob("*.jpg"))[::200]
    paths += sorted((shared_data / "gardens_point" / "day_left").glob("*.jpg"))[::80]
    paths += [shared_data / "odd_photos" / "portrait_6.jpg"]
    assert len(paths) > 5
    for path in paths:
        assert np.array_equal(
            read_gray(path, limits=LIMITS).pixels, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        ), path.name


def test_scaling_is_area_averaging_and_its_factor_is_reported():
    data = encode(picture(900, 600), "PNG")
    full, small = read_gray(data, limits=LIMITS), read_gray(data, limits=LIMITS, max_side=300)
    assert (full.scale, full.pixels.shape) == (1.0, (600, 900))
    assert (small.scale, small.pixels.shape, small.full_size) == (
        pytest.approx(1 / 3),
        (200, 300),
        (900, 600),
    )
    blocks = full.pixels.reshape(200, 3, 300, 3).mean(axis=(1, 3))
    assert np.abs(small.pixels - blocks).max() <= 0.5
    assert read_gray(data, limits=LIMITS, max_side=2000).scale == 1.0
    assert read_upright(data, limits=LIMITS, max_side=300).shape == (200, 300, 3)
    assert read_gray(encode(picture(2000, 1), "PNG"), limits=LIMITS, max_side=100).pixels.shape == (1, 100)


@pytest.mark.parametrize("mode", ["L", "LA", "RGBA", "P", "1", "CMYK", "YCbCr", "I;16", "F"])
def test_every_kind_of_pixel_becomes_eight_bits(mode):
    gray = np.asarray(Image.fromarray(picture()).convert("L"))
    if mode == "I;16":
        data = encode(gray.astype(np.uint16) * 257, "PNG")
    elif mode == "F":
        data = encode(gray.astype(np.float32) / 255, "TIFF")
    else:
        data = encode(picture(), "TIFF" if mode in ("CMYK", "YCbCr") else "PNG", mode=mode)
    found = read_gray(data, limits=LIMITS).pixels
    assert found.dtype == np.uint8
    assert np.corrcoef(found.ravel(), gray.ravel())[0, 1] > {"1": 0.3, "P": 0.95}.get(mode, 0.98)
    if mode in ("L", "LA", "I;16"):
        assert np.array_equal(found, gray)
    assert read_upright(data, limits=LIMITS).shape == (36, 48, 3)


def test_colours_are_in_the_order_of_opencv():
    data = encode(np.full((8, 8, 3), (250, 10, 60), np.uint8), "PNG")
    assert read_upright(data, limits=LIMITS)[4, 4].tolist() == [60, 10, 250]


@pytest.mark.parametrize("kind", ["GIF", "PNG", "TIFF", "WEBP"])
def test_of_several_frames_the_first_is_taken(kind):
    frames = [Image.new("RGB", (20, 10), colour) for colour in ("white", "black", "red")]
    file = io.BytesIO()
    frames[0].save(file, kind, save_all=True, append_images=frames[1:])
    assert read_gray(file.getvalue(), limits=LIMITS).pixels.min() > 250


def heic(pixels, **options):
    pillow_heif.register_heif_opener()
    return encode(pixels, "HEIF", quality=95, **options)


def test_heic_with_position(tmp_path):
    gps = {1: b"N", 2: ((50, 1), (30, 1), (0, 1)), 3: b"E", 4: ((14, 1), (0, 1), (0, 1))}
    path = tmp_path / "photo.jpg"  # the content decides the format, not the name
    path.write_bytes(heic(picture(64, 48), exif=piexif.dump({"GPS": gps})))
    facts = read_facts(path, limits=LIMITS)
    assert facts.gps == Gps(50.5, 14.0)
    assert (facts.width, facts.height) == (64, 48)
    assert np.abs(read_upright(path, limits=LIMITS)[:, :, ::-1].astype(int) - picture(64, 48)).mean() < 8


@pytest.mark.parametrize("orientation", range(1, 9))
def test_heic_is_turned_once(orientation):
    upright = picture(64, 48)
    data = heic(stored(upright, orientation), exif=piexif.dump({"0th": {274: orientation}}))
    facts, found = read_facts(data, limits=LIMITS), read_upright(data, limits=LIMITS)
    assert (facts.width, facts.height) == (64, 48)
    assert found.shape == (48, 64, 3)
    assert np.abs(found[:, :, ::-1].astype(int) - upright).mean() < 8


def png_header(width, height):
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = b"IDAT" + zlib.compress(b"\0" * 100)
    chunks = (
        struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in (header, data, b"IEND")
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


@pytest.mark.parametrize("side", [12_000, 50_000, 2**31 - 1])
@pytest.mark.parametrize("read", [read_facts, read_gray, read_upright])
def test_a_bomb_is_refused_by_its_header(side, read):
    with pytest.raises(PhotoError, match="pixels"):
        read(png_header(side, side), limits=LIMITS)


def test_limits_are_the_callers():
    data = encode(picture(100, 100), "PNG")
    assert read_facts(data, limits=PhotoLimits(max_megapixels=0.011)).width == 100
    with pytest.raises(PhotoError, match="megapixels"):
        read_facts(data, limits=PhotoLimits(max_megapixels=0.009))
    with pytest.raises(PhotoError, match="MB"):
        read_facts(data, limits=PhotoLimits(max_mb=len(data) / 1e6 * 0.9))


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP", "TIFF", "BMP", "HEIF"])
def test_a_file_cut_off_is_refused(kind):
    noisy = np.random.default_rng(0).integers(0, 255, (200, 200, 3), dtype=np.uint8)
    data = heic(noisy) if kind == "HEIF" else encode(noisy, kind)
    for part in (0.3, 0.6, 0.9):
        with pytest.raises(PhotoError):
            read_gray(data[: int(len(data) * part)], limits=LIMITS)
    assert read_gray(data, limits=LIMITS).full_size == (200, 200)


def test_a_jpeg_without_its_last_bytes_is_refused():
    data = encode(picture(), "JPEG")
    with pytest.raises(PhotoError):
        read_gray(data[:-2], limits=LIMITS)
    assert np.array_equal(
        read_gray(data + b"trailing", limits=LIMITS).pixels, read_gray(data, limits=LIMITS).pixels
    )


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff\xd8\xff",
        b"GIF89a",
        b"plain text, no photo",
        b"%PDF-1.7 ...",
        b"\x89PNG\r\n\x1a\n",
        b"\0" * 999,
    ],
)
@pytest.mark.parametrize("read", [read_facts, read_gray, read_upright])
def test_a_file_that_is_not_a_photo_is_refused(data, read):
    with pytest.raises(PhotoError):
        read(data, limits=LIMITS)


def test_errors_name_the_file(tmp_path):
    for name in ("missing.jpg", ".", "text.jpg"):
        (tmp_path / "text.jpg").write_text("no photo")
        with pytest.raises(PhotoError) as caught:
            read_facts(tmp_path / name, limits=LIMITS)
        assert caught.value.where == str(tmp_path / name)


def test_shared_odd_photos_are_read_or_refused(shared_data):
    paths = sorted((shared_data / "odd_photos").iterdir())
    positions = 0
    for path in paths:
        facts, gray = read_facts(path, limits=LIMITS), read_gray(path, limits=LIMITS, max_side=200)
        assert (facts.width, facts.height) == gray.full_size, path.name
        positions += bool(facts.gps)
    assert (len(paths), positions) == (32, 6)


@pytest.mark.parametrize("form", ["WEBP", "JPEG2000"])
def test_formats_that_take_much_memory_are_refused_at_fewer_pixels(form):
    """Decoding 120 megapixels would take 2 GB, from a file of 30 kB."""
    file = io.BytesIO()
    Image.new("RGB", (400, 300)).save(file, form)
    with pytest.raises(PhotoError, match=f"more than the limit of 0.1 for {form}"):
        read_gray(file.getvalue(), limits=PhotoLimits(max_megapixels=0.3))
    assert read_gray(file.getvalue(), limits=PhotoLimits(max_megapixels=0.37)).full_size == (400, 300)


@pytest.mark.parametrize("as_file", [False, True])
def test_a_jpeg_of_very_many_scans_is_refused_before_it_is_decoded(tmp_path, as_file, monkeypatch):
    """Each scan takes 500 bytes, but a pass over the whole photo."""
    monkeypatch.setattr(JpegImageFile, "load", None)
    source = progressive_jpeg(33)
    if as_file:
        (tmp_path / "a.jpg").write_bytes(source)
        source = tmp_path / "a.jpg"
    for read in (read_facts, read_gray, read_upright):
        with pytest.raises(PhotoError, match="unusual way"):
            read(source, limits=LIMITS)


def test_a_jpeg_of_many_scans_is_read():
    assert read_gray(progressive_jpeg(32), limits=LIMITS).pixels.shape == (300, 400)


def test_scans_of_thumbnails_and_of_what_follows_a_photo_do_not_count():
    data = progressive_jpeg(30)
    thumbnail = b"\xff\xe1" + (2 + 400).to_bytes(2, "big") + b"\xff\xda" * 200
    video = b"\xff\xda\x00\x02" * 200
    assert read_facts(data[:2] + thumbnail + data[2:] + video, limits=LIMITS).width == 400


def test_restart_markers_and_padding_are_no_other_markers():
    data = encode(picture(), "JPEG", restart_marker_blocks=1)
    assert b"\xff\xd0" in data
    assert not has_too_many_scans(data[:2] + b"\xff\xff" + data[2:])


@pytest.mark.parametrize("size", [(70_000, 1), (1, 70_000)])
def test_a_line_is_no_photo(size):
    with pytest.raises(PhotoError, match="70000 pixels long"):
        read_facts(encode(np.zeros(size[::-1], np.uint8), "PNG"), limits=LIMITS)


def test_wide_ranges_of_values_take_no_multiple_of_their_memory():
    file = io.BytesIO()
    Image.fromarray(np.zeros((2000, 3000), np.float32)).save(file, "TIFF")
    tracemalloc.start()
    read_gray(file.getvalue(), limits=LIMITS)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 4 * 2000 * 3000 * 4, "in bytes; as 64 bits at once it takes 6 times the file"


def heic_claiming(width, height, *, size=(256, 192)):
    """Make a HEIC file whose header claims another size than its picture has."""
    pillow_heif.register_heif_opener()
    file = io.BytesIO()
    Image.new("RGB", size, "green").save(file, "HEIF")
    data = file.getvalue()
    claim = b"ispe" + struct.pack(">III", 0, *size)
    assert claim in data
    return data.replace(claim, b"ispe" + struct.pack(">III", 0, width, height))


def test_a_heic_that_claims_too_many_pixels_is_refused_before_it_is_decoded(monkeypatch):
    data = heic_claiming(32_000, 32_000)
    monkeypatch.setattr(Image.Image, "load", lambda self: pytest.fail("it was decoded"))
    with pytest.raises(PhotoError, match=r"pixels|read|damaged"):
        read_gray(data, limits=LIMITS)


@pytest.mark.parametrize("claim", [(16, 16), (255, 191), (1, 100_000), (9000, 9000)])
def test_a_heic_that_claims_other_sides_costs_no_more_than_it_claims(claim):
    tracemalloc.start()
    with contextlib.suppress(PhotoError):
        found = read_gray(heic_claiming(*claim), limits=PhotoLimits(max_megapixels=90)).full_size
        assert found in (claim, (256, 192)), "what it is, or what it says"
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 600_000_000


@pytest.mark.parametrize(("black", "white"), [(0, 1023), (7000, 8020)], ids=["10 bits", "thermal"])
def test_16_bits_of_which_few_are_used_are_stretched(black, white):
    ramp = np.linspace(black, white, 64).astype(np.uint16)
    found = read_gray(encode(np.tile(ramp, (48, 1)), "PNG"), limits=LIMITS).pixels
    assert found.min() < 8 and found.max() > 247 and np.abs(found[0] - np.linspace(0, 255, 64)).max() < 8
    flat = read_gray(encode(np.full((48, 64), black + 300, np.uint16), "PNG"), limits=LIMITS).pixels
    assert np.ptp(flat) == 0


@pytest.mark.parametrize(("black", "white"), [(0, 1023), (0, 4095), (7000, 8020)], ids=["10", "12", "high"])
@pytest.mark.parametrize("kind", [".png", ".tif"])
@pytest.mark.parametrize("bands", [3, 4])
def test_colours_of_16_bits_of_which_few_are_used_are_stretched(black, white, kind, bands):
    ramp = np.linspace(black, white, 64).astype(np.uint16)
    blue = np.tile(ramp, (48, 1))
    channels = [blue, blue[:, ::-1], np.full_like(blue, black), np.full_like(blue, 65535)][:bands]
    data = cv2.imencode(kind, np.dstack(channels))[1].tobytes()
    blue, green, red = np.moveaxis(read_upright(data, limits=LIMITS).astype(int), 2, 0)
    expected = np.linspace(0, 255, 64)
    assert np.abs(blue - expected).max() < 8
    assert np.abs(green - expected[::-1]).max() < 8
    assert red.max() < 8
    assert "contrast was stretched" in contrast_note(data, limits=LIMITS)


@pytest.mark.parametrize("white", [0, 1023], ids=["black", "dark"])
def test_stretching_colours_takes_twelve_bytes_for_each_pixel_at_most(white):
    size = (1500, 2000)
    ramp = np.linspace(0, white, size[1]).astype(np.uint16)[:, None]
    opaque = np.full((size[1], 1), 65535, np.uint16)
    rows = np.tile(np.hstack([ramp, ramp, ramp, opaque]), (size[0], 1, 1))
    data = cv2.imencode(".png", rows)[1].tobytes()
    tracemalloc.start()
    with open_image(data, limits=LIMITS) as image:
        assert decode(image, "RGB").max() == (255 if white else 0)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 12.2 * size[0] * size[1]


def test_colours_of_very_large_photos_are_not_stretched(monkeypatch):
    monkeypatch.setattr("webapp.files.decode.MOST_OF_16_BITS", 48 * 64 - 1)
    data = cv2.imencode(".png", np.full((48, 64, 3), (0, 600, 1000), np.uint16))[1].tobytes()
    with open_image(data, limits=LIMITS) as image:
        assert decode(image, "RGB")[0, 0].tolist() == [3, 2, 0]
    assert contrast_note(data, limits=LIMITS) is None


def test_colours_of_all_16_bits_are_not_stretched():
    data = cv2.imencode(".png", np.full((48, 64, 3), (0, 30_000, 65_535), np.uint16))[1].tobytes()
    with open_image(data, limits=LIMITS) as image:
        assert decode(image, "RGB")[0, 0].tolist() == [255, 117, 0]
    assert contrast_note(data, limits=LIMITS) is None


def tiff_in_one_tile(width, height, side):
    """Make a TIFF with pixels of 8 bits in a single tile."""
    data = zlib.compress(bytes(side * side))
    entries = {256: width, 257: height, 258: 8, 259: 8, 262: 1, 277: 1, 322: side, 323: side, 324: 8}
    entries[325] = len(data)
    table = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in sorted(entries.items()))
    data += bytes(len(data) % 2)
    head = struct.pack("<2sHI", b"II", 42, 8 + len(data))
    return head + data + struct.pack("<H", len(entries)) + table + bytes(4)


def test_a_small_tiff_with_a_huge_tile_is_refused_before_it_is_decoded():
    with open_image(tiff_in_one_tile(64, 64, 256), limits=LIMITS) as image:
        assert decode(image, "L").shape == (64, 64)
    with (
        pytest.raises(PhotoError, match="64 x 64 pixels in tiles of 8192 x 8192"),
        open_image(tiff_in_one_tile(64, 64, 8192), limits=LIMITS),
    ):
        pass
