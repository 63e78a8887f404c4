"""The slow twin of the compiler: walks the tree of nodes each tick, as `nodes.py` describes them.

Plain and without any cleverness: what a node means is read off here, one method for each.
"""

from __future__ import annotations

from unicon_core.flow import (
    Block,
    Chain,
    Deferred,
    Every,
    Loop,
    Node,
    Switch,
    When,
    Zip,
    children_of,
)


class Interpreter:
    """Steps a tree; `step`, `deferred`, `warm_up` and `reset` as in `CompiledGraph`."""

    def __init__(self, root: Node) -> None:
        self.root = root
        self.now_child: dict[int, int] = {}  # Chain: the child that is up
        self.waited: dict[int, int] = {}  # Every: ticks since the start of the present period
        self.case: dict[int, int] = {}  # Switch: the case of the last tick
        self.blended: dict[int, int] = {}  # Switch: ticks blended since the last change of case
        self.due: list[Deferred] = []
        self.in_tail = False
        self.ending = False
        self.anew: set[int] = set()  # Deferred with `ends`: to be made fresh at the tick's end

    def step(self) -> bool:
        self.due.clear()
        return self.run(self.root)

    def deferred(self) -> bool:
        self.in_tail, self.ending = True, False
        due, self.due = self.due, []
        for node in due:
            self.run_deferred(node)
        self.in_tail = False
        if self.ending:
            self.fresh(self.root)
        self.fresh_late(self.root, set())
        return self.ending

    def reset(self) -> None:
        self.due.clear()
        self.fresh(self.root)
        self.fresh_late(self.root, set())

    # -- one tick -----------------------------------------------------------------------------

    def run(self, node: Node) -> bool:
        """Step a node; when it is done it is fresh afterwards."""
        done = {
            Block: self.run_block,
            Zip: self.run_zip,
            Chain: self.run_chain,
            Loop: self.run_loop,
            Every: self.run_every,
            When: self.run_when,
            Switch: self.run_switch,
            Deferred: self.run_deferred,
        }[type(node)](node)
        return bool(done)

    def run_block(self, block: Block) -> bool:
        done = bool(block.tick())
        if done and block.reset is not None:
            block.reset()
        return done

    def run_zip(self, node: Zip) -> bool:
        done = [self.run(child) for child in node.children]
        if any(done):
            for child, ended in zip(node.children, done):
                if not ended:
                    self.fresh(child)
        return any(done)

    def run_chain(self, node: Chain) -> bool:
        i = self.now_child.get(id(node), 0)
        if not self.run(node.children[i]):
            return False
        self.now_child[id(node)] = i + 1
        if i + 1 < len(node.children):
            return False
        self.now_child[id(node)] = 0
        return True

    def run_loop(self, node: Loop) -> bool:
        if self.run(node.child):
            if node.until is not None:
                self.fresh(node.until)
            return True
        if node.until is not None and node.until.tick():
            self.fresh(node.child)
            self.fresh(node.until)
            return True
        return False

    def run_every(self, node: Every) -> bool:
        waited = self.waited.get(id(node), 0)
        self.waited[id(node)] = (waited + 1) % node.n
        if waited == 0 and self.run(node.child):
            self.waited[id(node)] = 0
            return True
        return False

    def run_when(self, node: When) -> bool:
        if node.predicate.tick() and self.run(node.child):
            self.fresh(node.predicate)
            return True
        return False

    def run_switch(self, node: Switch) -> bool:
        new = node.index(node.selector.tick())
        old = self.case.get(id(node))
        if new != old:
            if old is not None:
                self.fresh(node.children[old])
                if node.blend:
                    node.blender.capture()
                    self.blended[id(node)] = 0
            self.case[id(node)] = new
        done = self.run(node.children[new])
        k = self.blended.get(id(node), node.blend) + 1
        if node.blend and k <= node.blend:
            node.blender.mix(k / (node.blend + 1))
            self.blended[id(node)] = k
        if done:
            self.case.pop(id(node), None)
            self.blended.pop(id(node), None)
            self.fresh(node.selector)
        return done

    def run_deferred(self, node: Deferred) -> bool:
        if not self.in_tail:
            self.due.append(node)
        elif self.run(node.child) and node.ends:
            self.ending = True
        return False

    # -- making fresh, warming up -------------------------------------------------------------

    def fresh(self, node: Node) -> None:
        if isinstance(node, Block):
            if node.reset is not None:
                node.reset()
            return
        if isinstance(node, Deferred) and node.ends:
            self.anew.add(id(node))  # it may still run in this tick
            return
        for child in children_of(node):
            self.fresh(child)
        for memory in (self.now_child, self.waited, self.case, self.blended):
            memory.pop(id(node), None)

    def fresh_late(self, node: Node, met: set[int]) -> None:
        if id(node) in met:
            return
        met.add(id(node))
        if id(node) in self.anew:
            self.anew.remove(id(node))
            self.fresh(node.child)
        for child in children_of(node):
            self.fresh_late(child, met)

    def warm_up(self) -> None:
        self.warm_up_node(self.root)

    def warm_up_node(self, node: Node) -> None:
        if isinstance(node, Block):
            if node.warm_up is not None:
                node.warm_up()
        elif isinstance(node, Chain):
            self.warm_up_node(node.children[self.now_child.get(id(node), 0)])
        elif isinstance(node, Switch):
            if id(node) in self.case:
                self.warm_up_node(node.children[self.case[id(node)]])
        elif isinstance(node, Every):
            if self.waited.get(id(node), 0) == 0:
                self.warm_up_node(node.child)
        elif not isinstance(node, Deferred):
            for child in children_of(node):
                self.warm_up_node(child)
