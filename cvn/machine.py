"""What programs that measure say of the machine."""

import platform


def processor() -> str:
  """The processor's name, as far as the system tells it."""
  try:
    with open('/proc/cpuinfo') as f:
      names = [line.split(':', 1)[1].strip() for line in f if line.startswith('model name')]
  except OSError:
    names = []
  return names[0] if names else platform.processor() or platform.machine()
