"""One module for each figure: a function from a run to matplotlib figures and the numbers behind them."""
