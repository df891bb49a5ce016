"""Statistics: data frames and arrays in, data frames and numbers out. Nothing here knows what a motion is."""
