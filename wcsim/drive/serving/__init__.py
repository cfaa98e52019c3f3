"""The way to browsers: files of the page, one socket a page, who may come in; what is driven is the runner's."""
