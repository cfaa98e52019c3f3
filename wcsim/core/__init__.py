"""What every room needs and nobody owns: frames, seeds, kernels, files, boxes, rotations, the joystick law.

No simulator, no configuration.
"""
