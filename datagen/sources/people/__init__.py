"""People from MakeHuman's body data: a file for each step from the data to the dressed mesh.

`data` reads the files, `body` mixes a body, `charts` measures it, `rig` finds its joints and bends
it, `poses` draws a pose from `families`, with `clearance` between limbs. `outfits` and `hair`
choose clothes, `garments` shapes them, `cloth` applies `patterns`, `face` paints the face, `layers`
cuts out the surfaces, and `person` combines everything. Lengths are decimetres, x is the person's
left, y is up, and people face +z.
"""
