"""What every room needs: frames, seeds, kernels, files, boxes, rotations, the joystick law.

No simulator, no configuration.
"""
