"""Recorded bags against ground truth: metrics, plots and reports."""
