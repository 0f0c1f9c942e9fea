"""People from MakeHuman's body data: one file a step, from the files to the dressed mesh.

`data` reads the files, `body` mixes a body, `charts` measures it, `rig` finds its joints and bends
it, `poses` says how, of `families`, with room between limbs (`clearance`). `outfits` and `hair`
choose what is worn, `garments` shapes it, `cloth` lays `patterns` on it, `face` paints the face,
`layers` cuts the surfaces out, and `person` puts all together.
Lengths are decimetres in all of them, x to the person's left, y up, and people face +z.
"""
