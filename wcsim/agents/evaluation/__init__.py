"""Policies judged in environments: KPIs, tables, confidence. `bench` measures wcsim, this measures policies."""
