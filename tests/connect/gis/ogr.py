"""Reads vector files with the GDAL library that rasterio brings: a reader that is not ours."""

import ctypes
from contextlib import contextmanager
from pathlib import Path

import pytest

_VECTOR = 0x04
_POINTER, _TEXT, _INT = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int
_FUNCTIONS = {
    "GDALOpenEx": (_POINTER, _TEXT, ctypes.c_uint, _POINTER, _POINTER, _POINTER),
    "GDALClose": (None, _POINTER),
    "GDALDatasetGetLayerCount": (_INT, _POINTER),
    "GDALDatasetGetLayer": (_POINTER, _POINTER, _INT),
    "GDALDatasetGetLayerByName": (_POINTER, _POINTER, _TEXT),
    "OGR_L_GetName": (_TEXT, _POINTER),
    "OGR_L_SetSpatialFilterRect": (None, _POINTER, *[ctypes.c_double] * 4),
    "OGR_L_TestCapability": (_INT, _POINTER, _TEXT),
    "OGR_L_GetNextFeature": (_POINTER, _POINTER),
    "OGR_F_GetGeometryRef": (_POINTER, _POINTER),
    "OGR_F_GetFieldCount": (_INT, _POINTER),
    "OGR_F_GetFieldDefnRef": (_POINTER, _POINTER, _INT),
    "OGR_F_GetFieldAsString": (_TEXT, _POINTER, _INT),
    "OGR_F_IsFieldSetAndNotNull": (_INT, _POINTER, _INT),
    "OGR_F_Destroy": (None, _POINTER),
    "OGR_Fld_GetNameRef": (_TEXT, _POINTER),
    "OGR_G_ExportToIsoWkt": (_INT, _POINTER, _POINTER),
    "VSIFree": (None, _POINTER),
    "CPLGetLastErrorMsg": (_TEXT,),
    "CPLErrorReset": (None,),
}


def _library():
    rasterio = pytest.importorskip("rasterio")
    found = sorted((Path(rasterio.__file__).parent.parent / "rasterio.libs").glob("libgdal*"))
    if not found:
        pytest.skip("rasterio brings no GDAL library here")
    gdal = ctypes.CDLL(str(found[0]))
    for name, (result, *arguments) in _FUNCTIONS.items():
        function = getattr(gdal, name)
        function.restype, function.argtypes = result, arguments
    gdal.GDALAllRegister()
    return gdal


@contextmanager
def _opened(path):
    gdal = _library()
    gdal.CPLErrorReset()
    dataset = gdal.GDALOpenEx(str(path).encode(), _VECTOR, None, None, None)
    assert dataset, gdal.CPLGetLastErrorMsg().decode()
    try:
        yield gdal, dataset
        assert gdal.CPLGetLastErrorMsg().decode() == ""
    finally:
        gdal.GDALClose(dataset)


def read_layers(path):
    """Return the features of each layer: dicts of texts, None where unset, with `geometry` as WKT."""
    found = {}
    with _opened(path) as (gdal, dataset):
        for number in range(gdal.GDALDatasetGetLayerCount(dataset)):
            layer = gdal.GDALDatasetGetLayer(dataset, number)
            found[gdal.OGR_L_GetName(layer).decode()] = list(_features(gdal, layer))
    return found


def read_within(path, layer, box):
    """Return the features of a layer in an area, and whether GDAL finds them by a spatial index."""
    with _opened(path) as (gdal, dataset):
        found = gdal.GDALDatasetGetLayerByName(dataset, layer.encode())
        gdal.OGR_L_SetSpatialFilterRect(found, *box)
        is_fast = bool(gdal.OGR_L_TestCapability(found, b"FastSpatialFilter"))
        return list(_features(gdal, found)), is_fast


def _features(gdal, layer):
    while feature := gdal.OGR_L_GetNextFeature(layer):
        values = {"geometry": _wkt(gdal, gdal.OGR_F_GetGeometryRef(feature))}
        for number in range(gdal.OGR_F_GetFieldCount(feature)):
            name = gdal.OGR_Fld_GetNameRef(gdal.OGR_F_GetFieldDefnRef(feature, number)).decode()
            is_set = gdal.OGR_F_IsFieldSetAndNotNull(feature, number)
            values[name] = gdal.OGR_F_GetFieldAsString(feature, number).decode() if is_set else None
        gdal.OGR_F_Destroy(feature)
        yield values


def _wkt(gdal, geometry):
    if not geometry:
        return None
    text = ctypes.c_void_p()
    gdal.OGR_G_ExportToIsoWkt(geometry, ctypes.byref(text))
    try:
        return ctypes.cast(text, ctypes.c_char_p).value.decode()
    finally:
        gdal.VSIFree(text)
