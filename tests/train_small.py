"""experiments.train for data of any size, to which the networks adapt; a program for tests."""

import numpy as np

from experiments import train

if __name__ == '__main__':
  train.check_sizes = lambda dataset: None
  train.draw_views = lambda *_: np.zeros((8, 8, 3), np.uint8)
  train.main()
