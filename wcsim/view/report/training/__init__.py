"""The page of a training: curves over its steps; what is shown of a test on a suite is in `view/report`."""
