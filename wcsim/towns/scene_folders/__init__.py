"""Folders of short street scenes made towns, and families of them with seeds.

Not what runs them (`wcsim/scenes`).
"""
