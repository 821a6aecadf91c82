"""Models of the court for other programs."""

import pycolmap

from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.reconstruct import reconstruct
from webapp.tasks.landmarks.stored import export_models, names_of_photos


def test_a_model_is_written_with_the_names_of_the_map(court, tmp_path):
    found = reconstruct(court.cfg, read_map(court.cfg), settings=Settings(), progress=Progress())
    (exported,) = export_models(found.folder, tmp_path / "out", names=names_of_photos(found))
    assert exported.folder == tmp_path / "out" / "0"
    model = pycolmap.Reconstruction()
    model.read_text(exported.folder)
    assert sorted(image.name for image in model.images.values()) == [f"photos/{n:02}.png" for n in range(9)]
    assert (exported.photos, exported.points) == (9, model.num_points3D())
    head = (exported.folder / "points.ply").read_bytes()[:200]
    assert head.startswith(b"ply")
    assert f"element vertex {exported.points}".encode() in head
