"""Words that came over the air, made fit for a terminal and a log."""


def legible(text: str) -> str:
    """One line of `text` that does nothing but stand there.

    Control characters (line breaks, escape sequences of a terminal) and invisible ones that turn the direction of reading
    become a replacement character each.
    """
    return "".join(c if c.isprintable() else "\ufffd" for c in text)
