"""Revocation lists that change while participants live: who is taken back in mid-session."""

from collections.abc import Iterator

from pqsec_pki.errors import PqsecError
from pqsec_pki.plugin.handles import Handles
from pqsec_pki.plugin.identity import Local
from pqsec_pki.plugin.meetings import Meetings


class Recalls:
    """What the lists of a connection's participants say of them and of their peers."""

    def __init__(self, handles: Handles, meetings: Meetings) -> None:
        self._handles, self._meetings = handles, meetings
        self._told: set[int] = set()

    def next(self) -> int:
        """The handle of one that is taken back and was not told; 0 if there is none.

        Then PqsecError of a list that cannot be taken.
        """
        refusal = self._read_anew()
        self._told.intersection_update(handle for handle, _ in self._handles.all(object))
        for handle in self._revoked():
            if handle not in self._told:
                self._told.add(handle)
                return handle
        if refusal:
            raise refusal
        return 0

    def _read_anew(self) -> PqsecError | None:
        """The lists whose files have changed, for further handshakes too."""
        refusal = None
        for handle, local in self._handles.all(Local):
            try:
                self._handles.replace(handle, local.with_newer_list())
            except PqsecError as error:
                refusal = error
        return refusal

    def _revoked(self) -> Iterator[int]:
        locals_ = dict(self._handles.all(Local))
        for handle, local in locals_.items():
            if local.takes_back(local.certificate):
                yield handle
        for identity, peer, certificate in self._meetings.authenticated():
            if identity in locals_ and locals_[identity].takes_back(certificate):
                yield peer
