"""Ratings files: what is read, and what is refused with its line."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from eval.ratings.reading import PEOPLE, SIMULATED, RatingsError, read_ratings, read_stimuli, same_answer

STIMULI = """stimulus,condition,clip_id,action,actor,attention,expected
s1,adult,c1,jump-high,a1,yes,
s2,child,c1,jump-high,b1,yes,jump high|jump
s3,adult,c2,walk,a1,no,
x1,,,,,yes,wave
"""
HEADER = "rater,stimulus,style,naturalness,action,order,seconds,time,kind\n"
GOOD = "r1,s1,adult,5,jump high,1,12.5,2026-11-22T18:30:00+00:00,people\n"


@pytest.fixture
def key(tmp_path):
    path = tmp_path / "stimuli.csv"
    path.write_text(STIMULI)
    return path


def written(tmp_path, text, name="ratings.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_good_rows_are_joined_to_what_was_shown(tmp_path, key):
    text = HEADER + GOOD + "r1,s2,CHILD,7.0, Jump ,2,,,\nr2,s2,,NA,walk,,,,people\nr2,x1,adult,4,Wave,,,,\n"
    ratings = read_ratings(written(tmp_path, text), key)
    table = ratings.table
    assert table["condition"].tolist() == ["adult", "child", "child", ""]
    assert table["child"].tolist()[:2] == [0.0, 1.0] and np.isnan(table["child"][2])
    assert table["naturalness"].tolist()[:2] == [5.0, 7.0] and np.isnan(table["naturalness"][2])
    assert table["correct"].tolist() == [1.0, 1.0, 0.0, 1.0]
    assert ratings.kind == PEOPLE and not ratings.simulated
    assert ratings.conditions == ["adult", "child"]
    assert len(ratings.judged) == 3
    assert any("2 of 12 answers are missing (style 1, naturalness 1)" in note for note in ratings.notes)
    assert any("2 raters did not see every stimulus: r1 (2 of 4), r2 (2 of 4)" in note for note in ratings.notes)


def test_an_action_that_does_not_count_for_attention_is_neither_right_nor_wrong(tmp_path, key):
    ratings = read_ratings(written(tmp_path, HEADER + "r1,s3,adult,5,jump,,,,\n"), key)
    assert np.isnan(ratings.table["correct"][0])


@pytest.mark.parametrize(
    "change", [lambda b: b"\xef\xbb\xbf" + b, lambda b: b.replace(b"\n", b"\r\n"), lambda b: b"# by us\n\n" + b]
)
def test_byte_order_mark_line_ends_and_remarks_change_nothing(tmp_path, key, change):
    plain = read_ratings(written(tmp_path, HEADER + GOOD), key)
    other = read_ratings(written(tmp_path, change((HEADER + GOOD).encode()), "other.csv"), key)
    assert other.table.equals(plain.table)


def test_a_file_without_the_action_question_says_so(tmp_path, key):
    ratings = read_ratings(written(tmp_path, "rater,stimulus,style,naturalness\nr1,s1,adult,3\n"), key)
    assert not ratings.asks_action
    assert "no action question" in " ".join(ratings.notes)


def test_other_styles_can_be_asked_for(tmp_path, key):
    path = written(tmp_path, "rater,stimulus,style,naturalness\nr1,s1,proud,3\n")
    assert read_ratings(path, key, styles=("neutral", "proud")).table["child"].tolist() == [1.0]
    with pytest.raises(RatingsError, match="style is adult or child, not 'proud'"):
        read_ratings(path, key)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("r1,s9,adult,5,walk,,,,", r"line 3: unknown stimulus 's9'; did you mean"),
        ("r1,kitchen,adult,5,walk,,,,", r"line 3: unknown stimulus 'kitchen': it is not in the stimuli file"),
        ("r1,s2,adult,8,walk,,,,", r"line 3: naturalness is a whole number from 1 to 7, not '8'"),
        ("r1,s2,adult,0,walk,,,,", r"line 3: naturalness is .* not '0'"),
        ("r1,s2,adult,4.5,walk,,,,", r"line 3: naturalness is .* not '4.5'"),
        ("r1,s2,adult,-3,walk,,,,", r"line 3: naturalness is .* not '-3'"),
        ("r1,s2,adult,five,walk,,,,", r"line 3: naturalness is .* not 'five'"),
        ("r1,s2,teenager,5,walk,,,,", r"line 3: style is adult or child, not 'teenager'"),
        ("r1,s1,adult,5,walk,,,,", r"line 3: rater 'r1' answered stimulus 's1' on line 2 already"),
        (",s2,adult,5,walk,,,,", r"line 3: the rater has no id"),
        ("r1,s2,adult,5,walk,0,,,", r"line 3: order counts .* from 1, and '0'"),
        ("r1,s2,adult,5,walk,1.5,,,", r"line 3: order counts"),
        ("r1,s2,adult,5,walk,,-1,,", r"line 3: seconds is .* not '-1'"),
        ("r1,s2,adult,5,walk,,inf,,", r"line 3: seconds is .* not 'inf'"),
        ("r1,s2,adult,5,walk,,soon,,", r"line 3: seconds is .* not 'soon'"),
        ("r1,s2,adult,5,walk,,,yesterday,", r"line 3: time is a date and time"),
        ("r1,s2,adult,5,walk,,,,robots", r"line 3: kind is 'people' or 'simulated observers, not people'"),
        ("r1,s2,adult,5", r"line 3: there are 4 cells, and the header has 9"),
        ("r1,s2,adult,5,walk,,,,,,", r"line 3: there are 11 cells, and the header has 9"),
        ('r1,s2,adult,5,"walk,,,,', r"line 3: the row cannot be read as CSV"),
    ],
)
def test_bad_rows_are_refused_with_their_line(tmp_path, key, row, message):
    path = written(tmp_path, HEADER + GOOD + row + "\n")
    with pytest.raises(RatingsError, match=message) as caught:
        read_ratings(path, key)
    assert str(path) in str(caught.value)
    assert caught.value.problems[0][0] == 3


def test_lines_are_those_of_the_file_after_remarks_blank_lines_and_long_cells(tmp_path, key):
    text = "# remark\n" + HEADER + '\nr1,s1,adult,5,"jump\nhigh",,,,\nr1,s2,adult,9,walk,,,,\n'
    with pytest.raises(RatingsError, match="line 6: naturalness"):
        read_ratings(written(tmp_path, text), key)


def test_all_problems_are_in_one_message_up_to_twenty(tmp_path, key):
    text = HEADER + "r1,s1,adult,9,walk,,,,\nr1,s1\n,s2,boy,5,walk,,,,\n"
    with pytest.raises(RatingsError) as caught:
        read_ratings(written(tmp_path, text), key)
    assert [line for line, _ in caught.value.problems] == [2, 3, 4, 4]
    assert "4 problems" in str(caught.value)
    many = HEADER + "".join(f"r{index},s1,adult,9,walk,,,,\n" for index in range(30))
    with pytest.raises(RatingsError) as caught:
        read_ratings(written(tmp_path, many), key)
    message = str(caught.value)
    assert "30 problems, the first 20 of them" in message
    assert "line 21:" in message and "line 22:" not in message
    assert len(caught.value.problems) == 30


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "the file is empty; ratings need the columns rater, stimulus, style, naturalness"),
        (b"\n\n", "the file is empty"),
        (HEADER.encode(), "the file has a header and no ratings"),
        (b"rater,stimulus,style,naturalnes\n", "line 1: unknown column 'naturalnes'; did you mean 'naturalness'"),
        (b"rater,stimulus,style\nr1,s1,adult\n", "line 1: the column 'naturalness' is missing"),
        (b"rater,rater,stimulus,style,naturalness\n", "the column 'rater' stands 2 times"),
        (b"rater;stimulus;style;naturalness\n", "parted by semicolons"),
        (b"rater\tstimulus\tstyle\tnaturalness\n", "parted by tabs"),
        (HEADER.encode() + GOOD.encode() + b"r\xe9mi,s2,adult,5,walk,,,,\n", "line 3: byte 0xe9 is not UTF-8"),
        ((HEADER + GOOD).encode("utf-16"), "UTF-16"),
        (b"PK\x03\x04rest", "workbook or archive"),
        (HEADER.encode() + b"r1\0,s1\n", "line 2: a zero byte"),
    ],
)
def test_files_that_are_no_ratings_are_refused(tmp_path, key, data, message):
    with pytest.raises(RatingsError, match=message):
        read_ratings(written(tmp_path, data), key)


def test_no_file_and_a_folder(tmp_path, key):
    with pytest.raises(RatingsError, match="no such file"):
        read_ratings(tmp_path / "none.csv", key)
    with pytest.raises(RatingsError, match="this is a folder"):
        read_ratings(tmp_path, key)


def test_answers_of_people_and_of_a_model_are_not_mixed(tmp_path, key):
    text = HEADER + GOOD + f'r2,s1,adult,5,walk,,,,"{SIMULATED}"\n'
    with pytest.raises(RatingsError, match="line 3: the kind changes here"):
        read_ratings(written(tmp_path, text), key)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("s1,adult,c9,walk,,,\n", "line 6: stimulus 's1' stands on line 2 already"),
        (",adult,c9,walk,,,\n", "line 6: the stimulus has no id"),
        ("s9,adult,,walk,,,\n", "line 6: clip_id is empty"),
        ("s9,adult,c9,,,,wave\n", "line 6: action is empty"),
        ("s9,adult,c9,walk,,maybe,\n", "line 6: attention is yes or no, not 'maybe'"),
        ("s9,,c9,walk,,no,\n", "line 6: the condition is empty"),
        ("s9,,,,,yes,\n", "line 6: an attention check needs an expected answer"),
    ],
)
def test_bad_stimuli_are_refused_with_their_line(tmp_path, text, message):
    with pytest.raises(RatingsError, match=message):
        read_stimuli(written(tmp_path, STIMULI + text))


def test_one_condition_is_no_comparison(tmp_path):
    with pytest.raises(RatingsError, match="two conditions or more to compare, and there is only 'adult'"):
        read_stimuli(written(tmp_path, "stimulus,condition,clip_id,action\ns1,adult,c1,walk\n"))


def test_what_the_stimuli_file_leaves_out_has_defaults(tmp_path):
    text = "stimulus,condition,clip_id,action\ns1,adult,c1,walk\ns2,child,c1,walk\n"
    table = read_stimuli(written(tmp_path, text))
    assert table["attention"].tolist() == [True, True]
    assert table["expected"].tolist() == ["walk", "walk"]


def test_free_answers_are_compared_without_case_and_signs():
    assert same_answer("Jump_high ", "walk|jump-high")
    assert not same_answer("jumping", "jump")


def test_the_error_survives_another_process():
    error = RatingsError("a.csv", [(3, "bad"), (1, "worse")])
    again = copy.copy(error)  # by __reduce__, as between processes
    assert str(again) == str(error) and again.problems == ((1, "worse"), (3, "bad"))
