"""What a motion looks like: playback in a browser, films, plots."""
