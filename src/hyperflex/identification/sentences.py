"""Sentences of a verdict that carry what they are about, so that no reader has to know their words."""

from enum import Enum


class About(Enum):
    """What a sentence is about, where somebody asks."""

    ALL_KNOWN = "all free parameters can be known"
    MEANING = "what a name of the result stands for"
    COLOURED = "residuals that are not noise"
    FRICTION = "frictions that another law would change"
    NOT_KNOWN = "values and ratios that are hardly known"
    UNTESTED = "lengths and times that this motion does not test"
    UNDETECTABLE = "lengths and times that no motion tests"
    ELSE = "anything else"


class Sentence(str):
    """A sentence, and what it is `about`."""

    about: About

    def __new__(cls, text: str, about: About = About.ELSE) -> "Sentence":
        """Make a sentence of its text."""
        made = super().__new__(cls, text)
        made.about = about
        return made


def about(text: str) -> About:
    """Return what a sentence is about."""
    return text.about if isinstance(text, Sentence) else About.ELSE


def capitalised(text: str) -> Sentence:
    """Return the sentence with a capital, about the same."""
    return Sentence(f"{text[0].upper()}{text[1:]}", about(text))
