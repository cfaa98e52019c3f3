"""Policies judged in environments: KPIs, tables, confidence."""
