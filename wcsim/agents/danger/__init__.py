"""The danger network: which joystick positions end badly, whatever the user wants to do."""
