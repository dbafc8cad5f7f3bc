import matplotlib.image
import numpy as np
from tables_for_tests import empty, typical

from bench.pictures import data_uri, write_summary


def test_the_summary_is_a_picture_with_lines_in_the_methods_colours(tmp_path):
    path = tmp_path / "summary.png"
    assert write_summary(typical(), path)
    pixels = matplotlib.image.imread(path)[..., :3]
    grey = np.all(np.abs(pixels - np.array([0x6E, 0x6E, 0x6E]) / 255.0) < 0.01, axis=-1)
    assert pixels.shape[0] > 300
    assert grey.sum() > 50  # the LF baseline's grey
    assert data_uri(path).startswith("data:image/png;base64,iVBOR")


def test_nothing_is_drawn_where_there_is_nothing_to_draw(tmp_path):
    assert not write_summary(empty(), tmp_path / "summary.png")
    assert not list(tmp_path.iterdir())
