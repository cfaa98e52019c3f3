"""The simulated user: perception, intent, hand. It holds the joystick; others correct it."""
