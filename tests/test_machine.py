from cvn.machine import processor


def test_the_processor_has_a_name():
  assert processor().strip()
