"""The reproduction: every number and figure of arXiv 2308.15177 from our own runs, with verdicts."""
