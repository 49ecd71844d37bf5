"""Published and closed-form results beside those of pinred (`pinred published`)."""
