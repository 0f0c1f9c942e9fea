"""What results are judged by beside cvn.metrics: baselines, intervals, the colours of the views."""
