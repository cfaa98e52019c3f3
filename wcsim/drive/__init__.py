"""A person drives: a chair in a town, steered from a web page; judging policies is `agents/evaluation`'s."""
