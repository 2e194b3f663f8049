"""Volume meshes: their cells and boundary, tetrahedra by fTetWild, and in a room of their own hexahedra."""
