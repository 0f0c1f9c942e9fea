"""Checks of HTML pages."""

from html.parser import HTMLParser

VOID = ('meta', 'img', 'br', 'link', 'input', 'hr')


class Tags(HTMLParser):
  """Collects tags and their attributes; raises if tags are not closed in order."""

  def __init__(self, text):
    super().__init__()
    self.tags, self.open = [], []
    self.feed(text)
    self.close()
    assert self.open == []

  def handle_starttag(self, tag, attrs):
    self.tags.append((tag, dict(attrs)))
    if tag not in VOID:
      self.open.append(tag)

  def handle_startendtag(self, tag, attrs):
    self.tags.append((tag, dict(attrs)))

  def handle_endtag(self, tag):
    assert self.open.pop() == tag


def check_alone(text, links=()):
  """Checks that a page is well-formed and loads nothing from elsewhere; returns its tags.

  Args:
    text: HTML.
    links: to other files, which the page may have.
  """
  tags = Tags(text).tags
  for tag, attributes in tags:
    assert tag != 'link' or attributes['href'] == 'data:,'
    assert attributes.get('src', 'data:').startswith('data:')
    assert attributes.get('href', '#').startswith(('#', 'data:')) or attributes['href'] in links
    assert not any(name.startswith('on') for name in attributes)
  assert 'http' not in text.replace('http-equiv', '')
  (policy,) = (a['content'] for t, a in tags if a.get('http-equiv') == 'Content-Security-Policy')
  assert policy.startswith("default-src 'none'; ")
  names = [a['id'] for _, a in tags if 'id' in a]
  assert len(names) == len({*names})
  return tags
