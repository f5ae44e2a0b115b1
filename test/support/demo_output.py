"""What the demo leaves behind: the keys of summary.json, and its pictures."""

ROBOT_KEYS = {
    "rms_m", "rms_paper_m", "gamma_final", "tilt_max_rad", "thrust_min", "thrust_max", "landed",
    "guaranteed_share", "tube_m", "error_max_m", "tube_z_m", "error_z_max_m",
}  # fmt: skip
KEYS = {
    "robots", "violations", "separation_min_m", "tick_median_us", "tick_p99_us", "dynamics", "rate_hz", "seconds",
    "plan",
}  # fmt: skip
PICTURES = ("paths.png", "gain.png", "inputs.png")
