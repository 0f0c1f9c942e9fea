"""The materials that Java 3D's OBJ loader has built in.

Sweet Home 3D's own models use them: `usemtl amber` without any `mtllib`. The table holds their
diffuse colours (`Kd`) in bytes, with an alpha (`d`) for glass. As in MTL files, `Kd` is taken as
sRGB.
"""

import posixpath

from datagen.reading.files import Files

_LIBRARY = 'java3d-built-in.mtl'

# name rrggbb, or rrggbbaa
_TABLE = """
amber 934400  amber_trans 93440029  aqua 008080  aqua_filter 5fab9405  archwhite fefefe
archwhite2 d6d6d6  bflesh 060201  black 010101  blondhair 92540b  blue_pure 0000ff
bluegrey 30474a  bluetint 0cb5f46e  blugrn 15a347  blutan 144234  bluteal 144234  bone e6c26d
bone1 fbcb78  bone2 fbdca6  brass 7a3200  brnhair 170803  bronze 110903  brown 160400
brownlips 24110a  brownskn 050200  brzskin 614a36  chappie 952e09  charcoal 010101
deepgreen 000501  default b5b3a7  dkblue 00010f  dkblue_pure 000022  dkbrown 020100
dkdkgrey 030303  dkgreen 010600  dkgrey 0c0c0c  dkorange b60900  dkpurple 06000c  dkred 3a0000
dkteal 00110b  emerald 0cff0040  fgreen 000b00  flaqua 008080  flblack 010101  flblonde 92540b
flblue_pure 0000b5  flbrown 1c0300  fldkblue_pure 000022  fldkdkgrey 030303  fldkgreen 010600
fldkgreen2 061201  fldkgrey 181818  fldkolivegreen 040501  fldkpurple 290055  fldkred 3a0202
flesh 866956  fleshtransparent b04b2140  flgrey 808080  fllime 00ff00  flltbrown 471d0e
flltgrey d2d2d2  flltolivegreen 0a0e03  flmintgreen 214a2b  flmustard e35a02  florange ff2b00
flpinegreen 1b3716  flpurple 6000c0  flred ff0000  fltan a97421  flwhite fbedd6  flwhite1 ffffff
flyellow ffaa00  glass 7c7d87  glassblutint 8eccc5ab  glasstransparent 78787840  gold ff7d00
green 004000  greenskn 001300  grey 2f2f2f  hair 000000  iris 000f51  jetflame f37e19
lavendar 381758  lcdgreen 96ff81  lighttan b36b38  lighttan2 503019  lighttan3 2e1504
lighttannew c99b52  lightyellow fff356  lime 00ff00  lips ec434a  ltbrown 471d0e  ltgrey 626262
meh 8eccc540  metal e6c26d  mintgrn 067a15  muscle 6b1216  navy_blue 00000e
offwhite.cool d5ae91  offwhite.warm d5b072  olivegreen 060900  orange ff2b00  pale_green 12610c
pale_pink a7346a  pale_yellow b09e33  peach a22f04  periwinkle 000ad3  pink fc2bab
pinktan af4237  plasma ff147240  purple 8000ff  red c50000  redbrick 540a02  redbrown 480200
redorange c10500  redwood 420800  rubber 030303  ruby ff000040  sand_stone 201d19
sapphire 0600ff40  shadow 09060540  ship2 ffffff  silver 9d9d9d  skin 1c0804  sky_blue 2097cc
smoked_glass 01010105  tan a98538  taupe 341f1b  teeth fbcb78  violet 070722  white ffffff
yellow ffaa00  yellow_green 306800  yellowbrt ffc800  yelloworng e23f00
"""


def with_built_in_materials(files: Files) -> Files:
  """The same files, in which OBJ files can use the built-in materials.

  An OBJ file without an MTL file gets one with these materials. In an existing MTL file they come
  first, so that its own materials replace those with the same name.
  """

  def read(name):
    if posixpath.basename(name) == _LIBRARY:
      return _MTL
    content = files.read(name)
    if name.lower().endswith('.obj') and b'mtllib' not in content:
      return f'mtllib {_LIBRARY}\n'.encode() + content
    return _MTL + content if name.lower().endswith('.mtl') else content

  return files._replace(read=read)


def _mtl():
  """The table as the text of an MTL file."""
  words = _TABLE.split()
  lines = []
  for name, digits in zip(words[::2], words[1::2], strict=True):
    r, g, b, alpha = (channel / 255 for channel in bytes.fromhex(digits.ljust(8, 'f')))
    lines.append(f'newmtl {name}\nKd {r:.4f} {g:.4f} {b:.4f}\nd {alpha:.4f}\n')
  return ''.join(lines).encode()


_MTL = _mtl()
