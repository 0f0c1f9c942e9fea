"""Evaluation beyond cvn.metrics: baselines, bootstrap intervals, colour complexity of views."""
