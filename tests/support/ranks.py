"""A process of a distributed training, which tells what crops it took."""

import torch
from torch.utils.data import DataLoader
from torch.utils.data.distributed import DistributedSampler

from defocus_core import BatchDataset

EPOCHS = range(4)


def train(rank, out, folder):
    """Take all samples in four epochs as one of two processes; the crops are written to a file.

    Twice: at first the data set is told which epoch it is.
    """
    store = f"file://{folder}/store"
    torch.distributed.init_process_group("gloo", init_method=store, rank=rank, world_size=2)
    both = [crops(rank, out, says_epoch) for says_epoch in (True, False)]
    torch.save(both, folder / f"{rank}.pt")
    torch.distributed.destroy_process_group()


def crops(rank, out, says_epoch):
    data = BatchDataset(out, ["coc"], crop=1, seed=3)
    sampler, places = DistributedSampler(data), []
    loader = DataLoader(data, batch_size=2, sampler=sampler, num_workers=rank)
    for epoch in EPOCHS:
        sampler.set_epoch(epoch)
        if says_epoch:
            data.set_epoch(epoch)
        for batch in loader:
            found = zip(batch["sample_id"], batch["place"].tolist(), strict=True)
            places += [(epoch, name, *place) for name, place in found]
    return places
