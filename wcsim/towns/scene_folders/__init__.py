"""Folders of short street scenes made towns, and families of them with seeds.

`wcsim/scenes` runs them.
"""
