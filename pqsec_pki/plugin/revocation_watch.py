"""Watches revocation lists, and finds participants and peers that were revoked while running."""

from collections.abc import Callable, Iterator
from dataclasses import replace

from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.plugin import lists
from pqsec_pki.plugin.handles import Handles
from pqsec_pki.plugin.identity import Local
from pqsec_pki.plugin.lists import NewestLists
from pqsec_pki.plugin.notes import Clock
from pqsec_pki.plugin.peer_table import PeerTable


class RevocationWatch:
    """Applies the revocation lists of a connection's participants to them and their peers."""

    def __init__(
        self,
        handles: Handles,
        peers: PeerTable,
        newest: NewestLists,
        clock: Clock,
        note: Callable[[str], None],
    ) -> None:
        self._handles, self._peers = handles, peers
        self._lists, self._now, self._note = newest, clock, note
        self._told: set[int] = set()

    def admitted(self, local: Local) -> Local:
        """A new participant, with the newest list of its CA that the agent knows.

        VerificationError if the list revokes it, or is not valid.
        """
        newest = self._with_newest(local)
        if newest is not local:
            problems = tuple(newest.anchors.identity_problems(newest.certificate, self._now()))
            if problems:
                raise VerificationError(*problems)
        return newest

    def next(self) -> int:
        """The handle of a revoked identity that was not reported yet; 0 if there is none.

        PqsecError for a refused list, after all handles were reported.
        """
        refusal = self._read_again()
        self._told.intersection_update(handle for handle, _ in self._handles.all(object))
        for handle in self._revoked():
            if handle not in self._told:
                self._told.add(handle)
                return handle
        if refusal:
            raise refusal
        return 0

    def _read_again(self) -> PqsecError | None:
        """Read the lists whose files have changed, for later handshakes; returns the last error."""
        refusal = None
        for handle, local in self._handles.all(Local):
            try:
                fresh = local.with_newer_list()
                newest = self._with_newest(fresh)
            except PqsecError as error:
                refusal = error
                continue
            if fresh is not local and newest is not fresh and fresh.revoked and newest.revoked:
                refusal = lists.refusal(fresh.revoked, newest.revoked)
                newest = replace(newest, list_state=local.list_state)  # to report it again
            self._handles.replace(handle, newest)
        return refusal

    def _with_newest(self, local: Local) -> Local:
        """`local`, or the same with a newer list that another participant of its CA has."""
        if local.revoked is None:
            return local
        ca, strict = local.anchors.identity_ca, local.anchors.signed_twice
        newest = self._lists.newest(ca, local.revoked, alternative=strict, now=self._now())
        if newest is local.revoked:
            return local
        self._note(
            f"list {newest.number} of {ca.subject_name}, which another"
            f" participant has, applies in place of list {local.revoked.number}"
        )
        return local.with_list(newest)

    def _revoked(self) -> Iterator[int]:
        locals_ = dict(self._handles.all(Local))
        for handle, local in locals_.items():
            if local.revokes(local.certificate):
                yield handle
        for identity, peer, certificate in self._peers.authenticated():
            if locals_[identity].revokes(certificate):
                yield peer
