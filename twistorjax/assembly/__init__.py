"""Energy, forces, and stiffness of all hinges, from those of one hinge.

Internal. Start reading in `kinematics`, which computes the displacement of one hinge from
those of its two bodies. `forces` and, in motion, `motion_forces` differentiate its
energy. `groups` stacks hinges of the same kind, `assembly` computes all hinges together,
and `tangent` their stiffness, whose entries `scatter` adds up. `stress` computes the
stresses, and `out_of_plane` the stiffness out of the plane.
"""
