"""What looks wrong in a data set, and pictures of it."""
