"""Pictures, videos and live tables for people. Nothing reads them back."""
