"""An explicit-state checker that runs the real server and client cores."""
