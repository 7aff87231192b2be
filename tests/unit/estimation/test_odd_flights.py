"""Words and numbers of a flight that differs."""

from estimation.structure.odd_flights import OddFlight

ODD = OddFlight("third", "mass or dynamic pressure", 1.25, 1e-9, "Cn_beta", 4.2)


def test_the_flight_its_ratio_and_what_it_moves_are_in_the_sentence_and_in_the_json() -> None:
    for words in ("third differs", "mass or dynamic pressure", "1.25 times", "Cn_beta by 4.2 bounds"):
        assert words in ODD.text
    data = ODD.to_json()
    assert (data["flight"], data["what"], data["ratio"], data["probability"]) == ("third", ODD.what, 1.25, 1e-9)


def test_of_two_flights_neither_is_accused() -> None:
    text = OddFlight("a", "lag of beta", 0.06, 1e-9, "Cn_r", 2.0, "b").text
    assert "a and b differ from one another" in text
    assert "0.06 s" in text
