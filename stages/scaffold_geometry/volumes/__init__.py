"""Volume meshes: cells and boundaries, tetrahedra by fTetWild, lattices, and hexahedra in a package of their own."""
