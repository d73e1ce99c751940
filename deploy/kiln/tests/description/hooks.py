"""What Schemathesis cannot know of the farm that end_to_end/description.rs has made."""

import os

import schemathesis

LONGEST_WAIT_SECS = 0


@schemathesis.hook
def before_call(context, case, kwargs):
    case.body = without_whole_floats(case.body)
    shorten_wait(case.query)
    shorten_wait(case.body)
    if case.operation.label == "POST /v1/bakes":
        name_stored_scene(case.body)
    if case.path.endswith(("/manifest", "/report")) and case.headers:
        # A part of a JSON document is none, but Schemathesis reads whatever says that it is JSON.
        case.headers.pop("Range", None)


def shorten_wait(values):
    """Long polls answer alike, however long they were to wait; those beyond the limit stay as they are. A query has texts, too."""
    if isinstance(values, dict):
        wait = values.get("wait_secs")
        is_number = type(wait) is int or (type(wait) is str and wait.isascii() and wait.isdecimal())
        if is_number and LONGEST_WAIT_SECS < int(wait) <= 60:
            values["wait_secs"] = type(wait)(LONGEST_WAIT_SECS)


def name_stored_scene(body):
    """A digest that was made up is that of no scene: half of them become one that is stored."""
    scene = body.get("scene") if isinstance(body, dict) else None
    if isinstance(scene, str) and len(scene) == 64 and scene[0] in "01234567":
        body["scene"] = os.environ["KILN_SCENE"]


def without_whole_floats(value):
    """JSON Schema takes 1.0 for an integer. This API does not, which no OpenAPI description can say."""
    if isinstance(value, dict):
        return {key: without_whole_floats(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [without_whole_floats(inner) for inner in value]
    return int(value) if isinstance(value, float) and value.is_integer() and abs(value) < 2**53 else value
