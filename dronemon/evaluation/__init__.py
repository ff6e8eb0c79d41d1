"""Measuring planners: episodes, tables and figures."""
