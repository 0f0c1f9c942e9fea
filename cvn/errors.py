"""The one exception that means: the user can mend this. Programs print it as one line."""


class UserError(Exception):
  """Bad input: names the file or value and the way out, in one line."""
