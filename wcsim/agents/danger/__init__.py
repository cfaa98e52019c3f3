"""Danger: a network that says of every joystick position whether it ends badly, whatever the user wishes."""
