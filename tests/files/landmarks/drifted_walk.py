"""A drifted model of a long walk: each camera shares points only with the next few."""

import math

import numpy as np
import pycolmap

from webapp.core.features.types import Features
from webapp.core.geometry import so3
from webapp.files.landmarks.match_database import MatchDatabase, two_view_geometry

PHOTOS, LENGTH, FOCAL = 22, 66.0, 500.0


def walk():
    """Return centres (n, 3) of cameras along an arc, x right, y down the map, z down, and rotations."""
    step = np.linspace(0.0, 1.0, PHOTOS)
    centre = np.column_stack([LENGTH * step, 25.0 * np.sin(2.5 * step), np.zeros(PHOTOS)])
    along = np.gradient(centre, axis=0)
    rotation = []
    for x, y, _ in along / np.linalg.norm(along, axis=1, keepdims=True):
        rotation.append([[-y, x, 0.0], [0.0, 0.0, 1.0], [x, y, 0.0]])
    return centre, np.array(rotation)


def drifted(rng, *, noise_px=0.3, turn_deg=1.5, growth=0.02):
    """Return the model, with numbers as names; rotation and scale drift along the walk."""
    centre, rotation = walk()
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(
        model="SIMPLE_RADIAL", width=640, height=480, params=[FOCAL, 320.0, 240.0, 0.0], camera_id=1
    )
    camera.has_prior_focal_length = True
    model.add_camera_with_trivial_rig(camera)
    at, own_at, own_rotation = [], [centre[0]], [rotation[0]]
    for number in range(1, PHOTOS):
        turn = so3.exp(np.array([0.0, 0.0, np.radians(turn_deg) * number]))
        step = (1.0 + growth) ** number * (centre[number] - centre[number - 1]) @ turn.T
        own_at.append(own_at[-1] + step)
        own_rotation.append(rotation[number] @ turn.T)
    seen = [[] for _ in range(PHOTOS)]
    tracks = []
    for number in range(PHOTOS - 1):
        ahead = np.column_stack([rng.uniform(-4, 4, 40), rng.uniform(-3, 3, 40), rng.uniform(7.0, 16.0, 40)])
        for place in ahead:
            truth = place @ rotation[number] + centre[number]
            track = []
            for other in range(max(0, number - 1), min(PHOTOS, number + 3)):
                x, y, depth = (truth - centre[other]) @ rotation[other].T
                xy = FOCAL * np.array([x, y]) / max(depth, 1e-9) + [320.0, 240.0]
                if depth > 1.0 and (xy > 0).all() and (xy < [640, 480]).all():
                    track.append((other, len(seen[other])))
                    seen[other].append(xy + rng.normal(0.0, noise_px, 2))
            scale = (1.0 + growth) ** number
            tracks.append(track)
            at.append(scale * place @ own_rotation[number] + own_at[number])
    for number in range(PHOTOS):
        image = pycolmap.Image(
            name=str(number), camera_id=1, image_id=number + 1,
            keypoints=np.array(seen[number]).reshape(-1, 2),
        )  # fmt: skip
        pose = pycolmap.Rigid3d(
            pycolmap.Rotation3d(own_rotation[number]), -own_rotation[number] @ own_at[number]
        )
        model.add_image_with_trivial_frame(image, pose)
    for place, track in zip(at, tracks, strict=True):
        if len(track) >= 2:
            elements = [pycolmap.TrackElement(other + 1, row) for other, row in track]
            model.add_point3D(place, pycolmap.Track(elements))
    return model


def write_matches(model, path):
    """Write the match database for all pairs of photos of a model that share points."""
    database = MatchDatabase(path)
    images = {int(image.name): image for image in model.images.values()}
    fov = math.degrees(2.0 * math.atan(320.0 / FOCAL))
    stored = {}
    for number in range(PHOTOS):
        xy = np.array([point.xy for point in images[number].points2D]).reshape(-1, 2)
        features = Features(
            xy=(xy - 0.5).astype(np.float32),
            size=np.ones(len(xy), np.float32),
            angle=np.zeros(len(xy), np.float32),
            descriptors=np.zeros((len(xy), 128), np.uint8),
            photo_size=(640, 480),
        )
        stored[number] = database.add(str(number), features, fov_deg=fov, is_guessed=False)
    row = {
        number: {
            point.point3D_id: n for n, point in enumerate(images[number].points2D) if point.has_point3D()
        }
        for number in range(PHOTOS)
    }
    for one in range(PHOTOS):
        for other in range(one + 1, min(PHOTOS, one + 4)):
            both = sorted(row[one].keys() & row[other].keys())
            matches = np.array([(row[one][id], row[other][id]) for id in both], np.uint32).reshape(-1, 2)
            geometry = two_view_geometry(stored[one], stored[other], matches=matches)
            database.keep(stored[one], stored[other], geometry=geometry)
    database.close()
