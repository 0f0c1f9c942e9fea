"""People from MakeHuman's body data: one file a step, from the files to the dressed mesh.

`data` reads the files, `body` mixes a body, `rig` finds its joints and bends it, `poses` says how,
`charts` measures its surface, `cloth` and `patterns` colour it, `outfits`, `hair` and `face` choose
what is worn and painted, `layers` cuts the surfaces out, and `person` puts all together.
Lengths are decimetres in all of them, x to the person's left, y up, and people face +z.
"""
