"""The motion core: clips, skeletons, files, rotations, contacts, alignment. Needs numpy and scipy only."""
