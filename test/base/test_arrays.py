"""Masks are asked quickly, whatever their shape and layout."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from flatsat_ros.base.arrays import all_of, any_of


@given(mask=arrays(bool, array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4)), reverse=st.booleans())
def test_masks_are_asked_as_numpy_would(mask: np.ndarray, reverse: bool) -> None:
    seen = mask.T[..., ::-1] if reverse and mask.ndim else mask
    assert any_of(seen) == seen.any()
    assert all_of(seen) == seen.all()
