"""Plan, execute, store and score: cells of data set x split x task x method x repetition."""
