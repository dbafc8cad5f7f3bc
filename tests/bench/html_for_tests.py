"""What tests see of an HTML page."""

import html.parser

VOID = {"meta", "input", "br", "img", "link", "hr", "path", "use", "rect"}
"""Elements that have no end."""


class Page(html.parser.HTMLParser):
    """The parts of a page, of which every element must be closed."""

    def __init__(self, text):
        super().__init__()
        self.tags = []
        """Each element's name with its attributes."""
        self.scripts = []
        """Each script's type with its text."""
        self.text = ""
        """All text outside scripts and styles."""
        self.open = []
        """Elements that are not closed."""
        self.feed(text)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        if "script" in self.open:
            self.scripts.append((self.tags[-1][1].get("type", ""), data))
        elif "style" not in self.open:
            self.text += data

    def all(self, tag):
        """Attributes of each element of that name."""
        return [attributes for name, attributes in self.tags if name == tag]

    @property
    def ids(self):
        """All identifiers."""
        return [attributes["id"] for _, attributes in self.tags if "id" in attributes]

    def check_loads_nothing(self):
        """Fails if the page loads something, or leads out of itself."""
        for tag, attributes in self.tags:
            assert tag not in ("link", "iframe", "object", "embed", "base")
            assert not {"src", "srcset", "data", "poster"} & set(attributes), tag
            for key in ("href", "xlink:href"):
                assert attributes.get(key, "#").startswith("#")
