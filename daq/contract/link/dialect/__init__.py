"""The MAVLink 2 dialect of the link: definition (`sideslip.xml`), its maker (`generate`), and the module built from it.

`own_messages.xml` is written by hand; the scan messages are derived from the channel table; the standard messages
are taken unchanged from the definitions that pymavlink ships. `sideslip_dialect` is built with the package (`build`).
"""

from daq.contract.link.dialect.build import ensure_module

ensure_module()
