"""Turn a film of an evaluation into the moving picture of the README, an animated WebP.

Usage: `python docs/moving_picture.py FILM.mp4 docs/drive.webp`. The film is the first one that
`python -m zsdist.evaluate pretrained --scenes ood-dynamic --episodes 1 --video films` makes.
"""

import sys

import cv2
from PIL import Image, ImageDraw, ImageFont

PANEL_PX, GAP_PX, TITLE_PX = 480, 6, 30  # of the film: panels side by side, each with its title at the top
WIDTH_PX, STRIP_PX = 240, 20  # of a panel here, and of the strip with our shorter titles
TITLES = ("from behind", "the car's camera", "the map it believes")
FRAMES_A_SECOND, QUALITY = 10, 45


def reduced(frame: Image.Image) -> Image.Image:
    """Return the three panels of a film's frame, smaller and side by side under shorter titles."""
    height = round((PANEL_PX - TITLE_PX) * WIDTH_PX / PANEL_PX)
    picture = Image.new("RGB", (len(TITLES) * (WIDTH_PX + 4) - 4, STRIP_PX + height), "white")
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(13)
    for index, title in enumerate(TITLES):
        left = index * (PANEL_PX + GAP_PX)
        panel = frame.crop((left, TITLE_PX, left + PANEL_PX, PANEL_PX)).resize((WIDTH_PX, height), Image.LANCZOS)
        picture.paste(panel, (index * (WIDTH_PX + 4), STRIP_PX))
        draw.text((index * (WIDTH_PX + 4) + 3, 2), title, "black", font)
    return picture


def main(film: str, picture: str) -> None:
    """Write `picture`, an animated WebP, from `film`, an MP4."""
    reader, frames = cv2.VideoCapture(film), []
    while (read := reader.read())[0]:
        frames.append(reduced(Image.fromarray(cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB))))
    durations = [1000 // FRAMES_A_SECOND] * (len(frames) - 1) + [2000]
    frames[0].save(
        picture, save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=QUALITY, method=4
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
