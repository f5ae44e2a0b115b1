"""The paper: flatness map, input set, gain law and, on one page, the controller. Numpy only, pure functions."""
