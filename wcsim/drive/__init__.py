"""A person steers a chair through a town from a web page; `agents/evaluation` judges policies."""
