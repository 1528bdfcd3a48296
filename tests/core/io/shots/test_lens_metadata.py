import math
import struct

import numpy as np
import pytest
from elements import write
from image_files import box, save

from defocus_core.io.shots.lens_metadata import lens_of


def exr(path, **attributes):
    return write(path, dict.fromkeys("RGB", np.ones((2, 3), np.float16)), **attributes)


def texts(path, metres=1.0):
    return {name: tuple(taken) for name, taken in lens_of(path, metres).items()}  # type: ignore[misc]


def test_the_standard_attributes_of_openexr(tmp_path):
    attributes = {"focus": 2.5, "aperture": 2.0, "tStop": 2.2, "nominalFocalLength": 50.0}
    attributes |= {"effectiveFocalLength": 51.0, "pinholeFocalLength": 52.0}
    sensor = {"sensorPhotositePitch": 8.0, "sensorAcquisitionRectangle": box(10, 0, 3009, 1999)}
    file = exr(tmp_path / "a.exr", **attributes, **sensor)
    assert texts(file) == {
        "focal-length": ("52mm", "pinholeFocalLength"),
        "fnumber": ("2", "aperture"),
        "sensor-width": ("24mm", "sensorPhotositePitch"),
        "focus": ("2.5m", "focus"),
    }


def test_the_first_attribute_that_makes_sense_wins_and_infinity_is_a_focus(tmp_path):
    file = exr(tmp_path / "a.exr", focus=math.inf, aperture=0.0, tStop=4.0, nominalFocalLength=35.0)
    assert texts(file) == {
        "focal-length": ("35mm", "nominalFocalLength"),
        "fnumber": ("4", "tStop"),
        "focus": ("inf", "focus"),
    }


def test_v_ray_measures_its_target_in_the_unit_of_the_scene(tmp_path):
    attributes = {"cameraFNumber": 8.0, "cameraFocalLength": 35.0, "cameraAperture": 36.0}
    file = exr(tmp_path / "a.exr", **attributes, cameraTargetDistance=200.0)
    assert texts(file, metres=0.01)["focus"] == ("2m", "cameraTargetDistance")
    assert texts(file)["sensor-width"] == ("36mm", "cameraAperture")
    none = exr(tmp_path / "b.exr", **attributes, cameraTargetDistance=1e18)
    assert "focus" not in texts(none)


def test_numbers_that_are_texts_are_read_and_other_texts_are_not(tmp_path):
    assert texts(exr(tmp_path / "a.exr", aperture="2.8", focus="far")) == {
        "fnumber": ("2.8", "aperture")
    }


@pytest.mark.parametrize(
    ("distance", "focus"), [(3.5, "3.5m"), (float(0xFFFFFFFF), "inf"), (0.0, None)]
)
def test_a_photograph_has_exif(tmp_path, distance, focus):
    exif = {"Exif__FocalLength": 26.0, "Exif__FNumber": 1.8, "FNumber": 1.8}
    exif |= {"Exif__FocalLengthIn35mmFilm": 52, "Exif__SubjectDistance": distance}
    file = save(tmp_path / "a.jpg", np.full((8, 12, 3), 128, np.uint8), **exif)
    taken = {name: text for name, (text, _) in texts(file).items()}
    assert taken.pop("focus", None) == focus
    assert taken == {"focal-length": "26mm", "fnumber": "1.8", "sensor-width": "18mm"}


@pytest.mark.parametrize(
    ("size", "turn", "millimetres"),
    [((24, 36), 1, 18), ((24, 36), 6, 12), ((36, 24), 1, 12), ((24, 32), 3, 17.3066)],
)
def test_the_sensor_has_the_diagonal_of_the_equivalent_and_the_shape_of_the_upright_frame(
    size, turn, millimetres, tmp_path
):
    exif = {"Exif__FocalLength": 26.0, "Exif__FocalLengthIn35mmFilm": 52, "Orientation": turn}
    file = save(tmp_path / "a.jpg", np.full((*size, 3), 128, np.uint8), **exif)
    assert texts(file)["sensor-width"][0] == f"{millimetres:g}mm"


def test_a_damaged_attribute_is_no_number(tmp_path):
    file = exr(tmp_path / "a.exr", aperture=2.0)
    data = file.read_bytes()
    at = data.index(b"aperture\0float\0") + len(b"aperture\0float\0") + 4
    file.write_bytes(data[:at] + struct.pack("<f", math.nan) + data[at + 4 :])
    assert texts(file) == {}
