"""The perceptual study: from a run's stored clips to ratings by people, through a small web site of one's own.

``build`` makes a study folder, ``app`` and ``serve`` show it to raters, ``simulate`` rehearses it, ``export`` and ``analysis``
turn what was answered into the files and the statistics of ``eval.ratings``.
"""
