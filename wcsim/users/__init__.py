"""The simulated user: perception, intent, hand. Whoever holds the joystick, never who corrects it."""
