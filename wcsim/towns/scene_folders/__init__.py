"""Folders of short street scenes made towns, and families of them with seeds; not what runs them (`wcsim/scenes`)."""
